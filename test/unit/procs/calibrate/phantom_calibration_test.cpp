// Self-calibration on recordings that nobody here made: the shared phantoms, whose sensors have
// unknown gain, alignment and offset errors.
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <sstream>

#include "calibrate/array_calibration.hpp"
#include "calibrate/magnet_pose_fit.hpp"

namespace gastronaut {
namespace {

std::string data_folder() {
  const char* given = std::getenv("GASTRONAUT_DATA");
  return given ? given : std::string(GASTRONAUT_SOURCE_DIR) + "/../shared/data";
}

Eigen::MatrixXd read_table(const std::string& path, char separator) {
  std::ifstream file(path);
  std::vector<std::vector<double>> rows;
  for (std::string line; std::getline(file, line);) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream cells(line);
    rows.emplace_back();
    for (std::string cell; std::getline(cells, cell, separator);) {
      if (!cell.empty()) rows.back().push_back(std::stod(cell));
    }
  }
  Eigen::MatrixXd table(rows.size(), rows.front().size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    table.row(static_cast<Eigen::Index>(i)) =
        Eigen::Map<const Eigen::RowVectorXd>(rows[i].data(), table.cols());
  }
  return table;
}

struct Phantom {
  RigConfiguration rig;
  std::vector<CalibrationReading> readings;
  std::vector<std::optional<MagnetPose>> truth;  // one a reading, at the camera's frames
};

SE3 pose_of(const Eigen::RowVectorXd& xyz_qxyzw) {
  return {Eigen::Quaterniond(xyz_qxyzw(6), xyz_qxyzw(3), xyz_qxyzw(4), xyz_qxyzw(5)).normalized(),
          xyz_qxyzw.head<3>().transpose()};
}

Phantom load_phantom(const std::string& folder) {
  Phantom phantom;
  const YAML::Node calib = YAML::LoadFile(folder + "/calib.yaml");
  RigConfiguration& rig = phantom.rig;
  rig.magnet.moment = calib["magnet"]["moment"].as<double>();
  rig.magnet.outer_radius = calib["magnet"]["outer_radius"].as<double>();
  rig.magnet.inner_radius = calib["magnet"]["inner_radius"].as<double>();
  rig.magnet.length = calib["magnet"]["length"].as<double>();
  rig.hall_array.rows = calib["hall"]["rows"].as<int>();
  rig.hall_array.cols = calib["hall"]["cols"].as<int>();
  rig.hall_array.pitch = calib["hall"]["pitch"].as<double>();
  rig.hall_array.z = calib["hall"]["z"].as<double>();
  rig.hall_array.noise = calib["hall"]["noise"].as<double>();
  const YAML::Node matrix = calib["coil_matrix_tesla_per_ampere"];
  rig.coils.tesla_per_ampere.resize(static_cast<Eigen::Index>(matrix.size()), 9);
  for (Eigen::Index row = 0; row < rig.coils.tesla_per_ampere.rows(); ++row) {
    for (Eigen::Index coil = 0; coil < 9; ++coil) {
      rig.coils.tesla_per_ampere(row, coil) =
          matrix[static_cast<std::size_t>(row)][static_cast<std::size_t>(coil)].as<double>();
    }
  }
  Eigen::RowVectorXd mount(7);
  for (Eigen::Index i = 0; i < 7; ++i) {
    const YAML::Node of = calib["camera_T_magnet"];
    mount(i) = i < 3 ? of["t"][static_cast<std::size_t>(i)].as<double>()
                     : of["q_xyzw"][static_cast<std::size_t>(i - 3)].as<double>();
  }
  const SE3 camera_T_magnet = pose_of(mount);
  const Eigen::MatrixXd hall = read_table(folder + "/hall.csv", ',');
  const Eigen::MatrixXd coils = read_table(folder + "/coils.csv", ',');
  const Eigen::MatrixXd poses = read_table(folder + "/groundtruth.txt", ' ');
  EXPECT_TRUE(hall.col(0).isApprox(coils.col(0))) << "readings and currents share their times";
  Eigen::Index pose = 0;
  for (Eigen::Index i = 0; i < hall.rows(); ++i) {
    CalibrationReading reading;
    reading.utime = static_cast<std::int64_t>(std::llround(hall(i, 0) * 1e6));
    reading.field = hall.row(i).tail(hall.cols() - 1);
    reading.usable.assign(static_cast<std::size_t>(reading.field.size()), true);
    reading.currents = coils.row(i).tail(9);
    phantom.readings.push_back(std::move(reading));
    constexpr double kSameTime = 1e-4;  // seconds; frames come every fifth reading
    while (pose + 1 < poses.rows() && poses(pose, 0) < hall(i, 0) - kSameTime) ++pose;
    phantom.truth.emplace_back();
    if (std::abs(poses(pose, 0) - hall(i, 0)) < kSameTime) {
      const SE3 rig_T_magnet = pose_of(poses.row(pose).tail(7)) * camera_T_magnet;
      phantom.truth.back() = {rig_T_magnet.translation,
                              rig_T_magnet.rotation * Eigen::Vector3d::UnitZ()};
    }
  }
  return phantom;
}

struct Errors {
  double median_position = 0;  // metres
  double rms_position = 0;
  double median_axis = 0;  // radians
};

// Of the second half, without the stretch in which phantom_b has a foreign field.
Errors errors_of_fixes(const Phantom& phantom, const RigConfiguration& rig) {
  constexpr double kForeignFieldFrom = 18;  // seconds, as the data's README says
  constexpr double kForeignFieldTo = 23;
  const MagnetPoseFitter fitter(rig);
  std::vector<double> positions;
  std::vector<double> axes;
  std::optional<MagnetPose> start;
  for (std::size_t i = 0; i < phantom.readings.size(); ++i) {
    const double time = static_cast<double>(phantom.readings[i].utime) * 1e-6;
    if (time >= kForeignFieldFrom && time <= kForeignFieldTo) continue;
    if (!phantom.truth[i] || i < phantom.readings.size() / 2) continue;
    const auto fit = fitter.fit(phantom.readings[i], start);
    if (!fit) {
      ADD_FAILURE() << "no fix at reading " << i;
      continue;
    }
    start = fit->pose;
    positions.push_back((fit->pose.position - phantom.truth[i]->position).norm());
    axes.push_back(std::acos(std::min(1.0, fit->pose.axis.dot(phantom.truth[i]->axis))));
  }
  Errors errors;
  for (const double position : positions) errors.rms_position += position * position;
  errors.rms_position = std::sqrt(errors.rms_position / static_cast<double>(positions.size()));
  std::sort(positions.begin(), positions.end());
  std::sort(axes.begin(), axes.end());
  errors.median_position = positions[positions.size() / 2];
  errors.median_axis = axes[axes.size() / 2];
  return errors;
}

class PhantomCalibration : public testing::TestWithParam<const char*> {};

// Calibrated from the first half's own unknown poses, judged by the true ones of the second.
TEST_P(PhantomCalibration, BringsFixesOfTheUnseenHalfNearerToTheTruth) {
  const std::string folder = data_folder() + "/" + GetParam();
  if (!std::ifstream(folder + "/hall.csv")) GTEST_SKIP() << "no shared data at " << folder;
  const Phantom phantom = load_phantom(folder);
  ArrayCalibrationOptions options;
  options.most_readings = 300;  // enough here, and quick
  const std::vector<CalibrationReading> first_half(
      phantom.readings.begin(),
      phantom.readings.begin() + static_cast<std::ptrdiff_t>(phantom.readings.size() / 2));
  const ArrayCalibration calibration =
      calibrate_array(phantom.rig, first_half, options, [](double) {});
  // Unseen readings are explained to the noise (and no better: five of 192 channels' worth of
  // freedom goes into each fix).
  constexpr double kNoiseBand = 0.06;
  EXPECT_NEAR(calibration.held_out_rms_after / phantom.rig.hall_array.noise, 1, kNoiseBand);
  EXPECT_GT(calibration.held_out_rms_before, 1.5 * phantom.rig.hall_array.noise);

  const Errors before = errors_of_fixes(phantom, phantom.rig);
  const Errors after = errors_of_fixes(phantom, calibration.rig);
  RecordProperty("median_position_mm_before", std::to_string(before.median_position * 1e3));
  RecordProperty("median_position_mm_after", std::to_string(after.median_position * 1e3));
  std::printf(
      "%s, second half: median %.3f -> %.3f mm, rms %.3f -> %.3f mm, axis %.3f -> %.3f deg\n",
      GetParam(), before.median_position * 1e3, after.median_position * 1e3,
      before.rms_position * 1e3, after.rms_position * 1e3, before.median_axis * 180 / M_PI,
      after.median_axis * 180 / M_PI);
  constexpr double kWorthwhile = 0.85;  // noise alone leaves about half of what there was
  EXPECT_LT(after.median_position, kWorthwhile * before.median_position);
  EXPECT_LT(after.rms_position, kWorthwhile * before.rms_position);
}

INSTANTIATE_TEST_SUITE_P(Shared, PhantomCalibration,
                         testing::Values("phantom_a", "phantom_b", "phantom_c"),
                         [](const auto& test) { return std::string(test.param); });

}  // namespace
}  // namespace gastronaut

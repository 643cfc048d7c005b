#include "regression/magnetics/recordings.hpp"

#include <yaml-cpp/yaml.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <map>
#include <sstream>

namespace gastronaut::test {
namespace {

constexpr double kMicrotesla = 1e-6;
constexpr double kMillimetre = 1e-3;

// All numbers of each line; whatever is no number separates.
std::vector<std::vector<double>> read_numbers(const std::filesystem::path& file) {
  std::ifstream in(file);
  std::vector<std::vector<double>> rows;
  for (std::string line; std::getline(in, line);) {
    if (line.starts_with('#')) continue;
    std::vector<double> row;
    const char* at = line.c_str();
    while (*at != '\0') {
      char* end = nullptr;
      const double value = std::strtod(at, &end);
      if (end == at) {
        ++at;
      } else {
        row.push_back(value);
        at = end;
      }
    }
    rows.push_back(std::move(row));
  }
  return rows;
}

Eigen::Matrix3d rotation_from_vector(const Eigen::Vector3d& v) {
  return Eigen::AngleAxisd(v.norm(), v.normalized()).toRotationMatrix();
}

}  // namespace

std::optional<std::filesystem::path> shared_data() {
  const char* named = std::getenv("GASTRONAUT_DATA");
  const std::filesystem::path path =
      named != nullptr ? std::filesystem::path(named)
                       : std::filesystem::path(GASTRONAUT_SOURCE_DIR) / "../shared/data";
  if (!std::filesystem::is_directory(path)) return std::nullopt;
  return path;
}

Recording read_capture(const std::filesystem::path& folder) {
  Recording recording;
  const YAML::Node calibration = YAML::LoadFile(folder / "calib.yaml");
  RigConfiguration& rig = recording.rig;
  rig.magnet.moment = calibration["magnet"]["moment"].as<double>();
  rig.magnet.outer_radius = calibration["magnet"]["outer_radius"].as<double>();
  rig.magnet.inner_radius = calibration["magnet"]["inner_radius"].as<double>();
  rig.magnet.length = calibration["magnet"]["length"].as<double>();
  rig.hall_array.rows = calibration["hall"]["rows"].as<int>();
  rig.hall_array.cols = calibration["hall"]["cols"].as<int>();
  rig.hall_array.pitch = calibration["hall"]["pitch"].as<double>();
  rig.hall_array.z = calibration["hall"]["z"].as<double>();
  rig.hall_array.noise = calibration["hall"]["noise"].as<double>();
  const YAML::Node matrix = calibration["coil_matrix_tesla_per_ampere"];
  rig.coils.tesla_per_ampere.resize(static_cast<Eigen::Index>(matrix.size()),
                                    static_cast<Eigen::Index>(matrix[0].size()));
  for (std::size_t i = 0; i < matrix.size(); ++i) {
    for (std::size_t j = 0; j < matrix[i].size(); ++j) {
      rig.coils.tesla_per_ampere(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(j)) =
          matrix[i][j].as<double>();
    }
  }
  const auto t = calibration["camera_T_magnet"]["t"].as<std::vector<double>>();
  const auto q = calibration["camera_T_magnet"]["q_xyzw"].as<std::vector<double>>();
  const SE3 camera_T_magnet{Eigen::Quaterniond(q[3], q[0], q[1], q[2]).normalized(),
                            Eigen::Vector3d(t.data())};

  const auto milliseconds = [](double time) { return std::lround(time * 1e3); };
  std::map<long, TrueMagnet> truths;
  for (const std::vector<double>& row : read_numbers(folder / "groundtruth.txt")) {
    if (row.size() != 8) continue;
    const SE3 rig_T_camera{Eigen::Quaterniond(row[7], row[4], row[5], row[6]).normalized(),
                           Eigen::Vector3d(&row[1])};
    const SE3 rig_T_magnet = rig_T_camera * camera_T_magnet;
    truths[milliseconds(row[0])] = {rig_T_magnet.translation,
                                    rig_T_magnet.rotation * Eigen::Vector3d::UnitZ()};
  }
  std::map<long, Eigen::VectorXd> currents;
  for (const std::vector<double>& row : read_numbers(folder / "coils.csv")) {
    currents[milliseconds(row[0])] =
        Eigen::Map<const Eigen::VectorXd>(&row[1], static_cast<Eigen::Index>(row.size()) - 1);
  }
  for (const std::vector<double>& row : read_numbers(folder / "hall.csv")) {
    const auto truth = truths.find(milliseconds(row[0]));
    if (truth == truths.end()) continue;
    RecordedReading reading;
    reading.time = row[0];
    reading.hall.field =
        Eigen::Map<const Eigen::VectorXd>(&row[1], static_cast<Eigen::Index>(row.size()) - 1);
    reading.hall.status.setZero(rig.hall_array.num_sensors());
    reading.currents = currents.at(milliseconds(row[0]));
    reading.truth = truth->second;
    recording.readings.push_back(std::move(reading));
  }
  return recording;
}

Recording read_magnet_board(const std::filesystem::path& folder, int run) {
  // Columns of second_phase_dataN.csv; SOURCE.txt explains them.
  enum Column { kId, kField, kSensor = 4, kSensorTurn = 7, kMagnet = 16, kMagnetTurn = 19 };
  constexpr std::size_t kNumColumns = 23;
  constexpr int kNumSensors = 16;
  constexpr double kMeanMoment = 0.858;  // A m^2, SOURCE.txt
  const std::string name = "second_phase_data" + std::to_string(run);
  const auto background = read_numbers(folder / (name + "_G.csv"));
  std::vector<std::vector<double>> rows;
  for (auto& row : read_numbers(folder / (name + ".csv"))) {
    if (row.size() == kNumColumns) rows.push_back(std::move(row));
  }
  const auto vector = [](const std::vector<double>& row, int column) {
    return Eigen::Vector3d(&row[static_cast<std::size_t>(column)]);
  };

  // Rig frame: origin in the first sensor, x along a row of four, y along a column, z away from
  // the magnet.
  const Eigen::Vector3d origin = vector(rows[0], kSensor);
  const Eigen::Vector3d along_row = (vector(rows[3], kSensor) - origin).normalized();
  const Eigen::Vector3d towards_last = vector(rows[kNumSensors - 1], kSensor) - origin;
  Eigen::Vector3d normal = along_row.cross(towards_last).normalized();
  if (normal.dot(vector(rows[0], kMagnet) - origin) > 0) normal = -normal;
  Eigen::Matrix3d rig_R_world;
  rig_R_world << along_row.transpose(), normal.cross(along_row).transpose(), normal.transpose();

  Recording recording;
  RigConfiguration& rig = recording.rig;
  rig.magnet.moment = kMeanMoment;
  // A cylinder, 5 mm in radius and in half length.
  rig.magnet.outer_radius = 5 * kMillimetre;
  rig.magnet.inner_radius = 0;
  rig.magnet.length = 10 * kMillimetre;
  rig.hall_array.rows = 4;
  rig.hall_array.cols = 4;
  // SOURCE.txt: the calibrated model explains the field to 1 %; the background is subtracted.
  rig.hall_array.gain_std = 0.01;
  rig.hall_array.alignment_std = 0.01;
  rig.magnetic_localizer.background_std = 2 * kMicrotesla;
  rig.hall_array.saturation = 0.05;
  rig.magnetic_localizer.search_half_width = 0.06;
  rig.magnetic_localizer.search_depth = 0.1;
  for (std::size_t s = 0; s < kNumSensors; ++s) {
    HallSensorConfiguration sensor;
    sensor.position = kMillimetre * (rig_R_world * (vector(rows[s], kSensor) - origin));
    sensor.response =
        rotation_from_vector(vector(rows[s], kSensorTurn)).transpose() * rig_R_world.transpose();
    for (const double offset : background[s]) sensor.offset.push_back(kMicrotesla * offset);
    rig.hall_array.sensors.push_back(std::move(sensor));
  }
  for (std::size_t first = 0; first + kNumSensors <= rows.size(); first += kNumSensors) {
    RecordedReading reading;
    reading.time = rows[first].back();
    reading.hall.field.resize(3 * kNumSensors);
    reading.hall.status.setZero(kNumSensors);
    for (std::size_t s = 0; s < kNumSensors; ++s) {
      reading.hall.field.segment<3>(static_cast<Eigen::Index>(3 * s)) =
          kMicrotesla * vector(rows[first + s], kField);
    }
    reading.truth = {kMillimetre * (rig_R_world * (vector(rows[first], kMagnet) - origin)),
                     rig_R_world * rotation_from_vector(vector(rows[first], kMagnetTurn)).col(2)};
    recording.readings.push_back(std::move(reading));
  }
  return recording;
}

Recording read_magnetometer_10(const std::filesystem::path& file) {
  // Centimetres, SOURCE.txt.
  constexpr double kLayout[10][2] = {{0, -.8}, {.5, -.5}, {-.5, -.5}, {1, 0}, {0, 0},
                                     {-1, 0},  {.5, .5},  {-.5, .5},  {1, 1}, {-1, 1}};
  constexpr std::size_t kNumChannels = 30;
  Recording recording;
  for (const auto& place : kLayout) {
    HallSensorConfiguration sensor;
    sensor.position = {1e-2 * place[0], 1e-2 * place[1], 0};
    recording.rig.hall_array.sensors.push_back(sensor);
  }
  for (const std::vector<double>& row : read_numbers(file)) {
    if (row.size() < kNumChannels) continue;  // the heading
    RecordedReading reading;
    reading.hall.field = kMicrotesla * Eigen::Map<const Eigen::VectorXd>(
                                           &row[row.size() - kNumChannels], kNumChannels);
    reading.hall.status.setZero(10);
    recording.readings.push_back(std::move(reading));
  }
  return recording;
}

}  // namespace gastronaut::test

// The localiser on recordings that nobody here made, against what their authors and an
// off-the-shelf fit reach on them.
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>

#include "bench/magnetic_localizer/ceres_fit.hpp"
#include "magnetic_localizer/magnetic_localizer.hpp"
#include "regression/magnetics/recordings.hpp"
#include "unit/procs/magnetic_localizer/simulated_array.hpp"

namespace gastronaut {
namespace {

using magnetics::FixStatus;
using magnetics::MagneticFix;
using magnetics::MagneticLocalizer;

constexpr double kMillimetre = 1e-3;
constexpr double kDegree = std::numbers::pi / 180;

struct Errors {
  std::vector<double> position;  // metres
  std::vector<double> axis;      // radians
  double predicted_square = 0;   // metres^2, sum
  double nees = 0;               // sum

  void add(const test::TrueMagnet& truth, const magnetics::MagnetState& state) {
    const Vector5d error = test::pose_error(truth.position, truth.axis, state);
    position.push_back(error.head<3>().norm());
    axis.push_back(error.tail<2>().norm());
  }
  void add(const test::TrueMagnet& truth, const MagneticFix& fix) {
    add(truth, fix.state);
    const Vector5d error = test::pose_error(truth.position, truth.axis, fix.state);
    predicted_square += fix.covariance.topLeftCorner<3, 3>().trace();
    nees += error.dot(fix.covariance.llt().solve(error));
  }
  double predicted() const {
    return std::sqrt(predicted_square / static_cast<double>(position.size()));
  }
  double mean_nees() const { return nees / (5 * static_cast<double>(position.size())); }
};

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values[values.size() / 2];
}

double mean(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value;
  return sum / static_cast<double>(values.size());
}

double rms(const std::vector<double>& values) {
  double sum = 0;
  for (const double value : values) sum += value * value;
  return std::sqrt(sum / static_cast<double>(values.size()));
}

class Recordings : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto data = test::shared_data();
    if (!data) {
      GTEST_SKIP() << "the shared recordings are absent: set GASTRONAUT_DATA to their folder";
    }
    data_ = *data;
  }

  test::Recording phantom(const std::string& name) const {
    test::Recording recording = test::read_capture(data_ / name);
    // README.md: "small unknown gain, offset and alignment errors". The default 0.5 % and 5 mrad;
    // the offsets stand out in the residuals as about twice the noise.
    recording.rig.hall_array.offset_std = 3e-6;
    // The coil matrix is that of ideal sensors: half a per cent of its typical entry.
    recording.rig.coils.tesla_per_ampere_std = 2.5e-7;
    return recording;
  }

  std::filesystem::path data_;
};

// When a foreign magnet is there (README.md: from 18 to 23 s).
bool foreign_field(const std::string& name, double time) {
  return name == "phantom_b" && time >= 18 && time < 23;
}

TEST_F(Recordings, PhantomsAreLocalisedAsWellAsByAnOffTheShelfFitOrBetter) {
  constexpr double kAsWell = 1.05;  // one static draw of sensor errors: weights may lose a little
  // README of the issue: 0.7 to 0.85 mm median, 0.9 mm RMS, 0.8 degree (phantom_a).
  constexpr double kMedian = 0.85 * kMillimetre;
  constexpr double kRms = 0.9 * kMillimetre;
  constexpr double kAxis = 0.85 * kDegree;  // 0.8 to the digit given
  // Sensor errors stand still during a recording, so this is one draw of five numbers, not
  // hundreds; chi-square over 5 of one draw is below 3 in 99 %.
  constexpr double kHonest = 3;
  for (const std::string name : {"phantom_a", "phantom_b", "phantom_c"}) {
    SCOPED_TRACE(name);
    const test::Recording recording = phantom(name);
    const auto sensors = recording.rig.hall_array.resolved_sensors();
    MagneticLocalizer localizer(recording.rig);
    Errors errors;
    Errors peer_errors;
    for (const test::RecordedReading& reading : recording.readings) {
      const MagneticFix fix = localizer.localize(reading.hall, reading.currents);
      if (foreign_field(name, reading.time)) {
        EXPECT_EQ(fix.status, FixStatus::kInterference) << "at " << reading.time << " s";
        continue;
      }
      EXPECT_EQ(fix.status, FixStatus::kOk) << "at " << reading.time << " s";
      errors.add(*reading.truth, fix);
      magnetics::MagnetState peer;
      peer.position = reading.truth->position;
      peer.axis = reading.truth->axis;
      ASSERT_TRUE(test::ceres_fit(
          recording.rig, sensors,
          reading.hall.field - recording.rig.coils.tesla_per_ampere * *reading.currents, peer));
      peer_errors.add(*reading.truth, peer);
    }
    std::printf(
        "%s: %zu fixes, position median %.3f rms %.3f (predicted %.3f, Ceres %.3f) mm, "
        "axis median %.2f (Ceres %.2f) degree, NEES/5 %.2f\n",
        name.c_str(), errors.position.size(), median(errors.position) / kMillimetre,
        rms(errors.position) / kMillimetre, errors.predicted() / kMillimetre,
        rms(peer_errors.position) / kMillimetre, median(errors.axis) / kDegree,
        median(peer_errors.axis) / kDegree, errors.mean_nees());
    EXPECT_LT(rms(errors.position), kAsWell * rms(peer_errors.position));
    EXPECT_LT(rms(errors.axis), kAsWell * rms(peer_errors.axis));
    EXPECT_LT(errors.mean_nees(), kHonest);
    if (name == "phantom_a") {
      EXPECT_LT(median(errors.position), kMedian);
      EXPECT_LT(rms(errors.position), kRms);
      EXPECT_LT(median(errors.axis), kAxis);
    }
  }
}

TEST_F(Recordings, KnownOffsetsBringThePhantomsBelowTheOffTheShelfFigures) {
  // What calibration is worth: offsets (with the background) as the mean of what truth leaves
  // unexplained in every other second, fixes in the seconds between.
  constexpr double kPublished = 0.7 * kMillimetre;  // the best median without calibration
  for (const std::string name : {"phantom_a", "phantom_b"}) {
    SCOPED_TRACE(name);
    test::Recording recording = phantom(name);
    RigConfiguration& rig = recording.rig;
    const auto calibrates = [](double time) { return std::lround(std::floor(time)) % 2 == 0; };
    Eigen::VectorXd sum = Eigen::VectorXd::Zero(3 * 64);
    int count = 0;
    for (const test::RecordedReading& reading : recording.readings) {
      if (!calibrates(reading.time) || foreign_field(name, reading.time)) continue;
      magnetics::MagnetState state;
      state.position = reading.truth->position;
      state.axis = reading.truth->axis;
      state.moment = rig.magnet.moment;
      sum += reading.hall.field - rig.coils.tesla_per_ampere * *reading.currents -
             test::simulate_reading(rig.hall_array, rig.magnet, state, nullptr).field;
      ++count;
    }
    rig.hall_array.sensors = rig.hall_array.resolved_sensors();
    for (std::size_t s = 0; s < rig.hall_array.sensors.size(); ++s) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        rig.hall_array.sensors[s].offset[axis] =
            sum[static_cast<Eigen::Index>(3 * s + axis)] / count;
      }
    }
    rig.hall_array.offset_std = rig.hall_array.noise / std::sqrt(count);
    rig.magnetic_localizer.background_std = 1e-6;  // tesla: it is among the offsets
    MagneticLocalizer localizer(rig);
    Errors errors;
    for (const test::RecordedReading& reading : recording.readings) {
      if (calibrates(reading.time) || foreign_field(name, reading.time)) continue;
      errors.add(*reading.truth, localizer.localize(reading.hall, reading.currents));
    }
    std::printf(
        "%s, offsets known: position median %.3f rms %.3f (predicted %.3f) mm, axis "
        "median %.2f degree\n",
        name.c_str(), median(errors.position) / kMillimetre, rms(errors.position) / kMillimetre,
        errors.predicted() / kMillimetre, median(errors.axis) / kDegree);
    EXPECT_LT(median(errors.position), kPublished);
  }
}

TEST_F(Recordings, SecondDifferencesAreHonestOnThePhantomsAndLessAccurate) {
  constexpr double kPaper = 2.1 * kMillimetre;  // Son 2016: mean error within 5 cm; here 7 to 10
  constexpr double kHonest = 3;
  test::Recording recording = phantom("phantom_a");
  MagneticLocalizer full_field(recording.rig);
  recording.rig.magnetic_localizer.estimator = MagneticEstimator::kSecondDifference;
  MagneticLocalizer second_difference(recording.rig);
  Errors full_errors;
  Errors errors;
  for (const test::RecordedReading& reading : recording.readings) {
    full_errors.add(*reading.truth, full_field.localize(reading.hall, reading.currents));
    errors.add(*reading.truth, second_difference.localize(reading.hall, reading.currents));
  }
  std::printf("second differences: position median %.3f rms %.3f (predicted %.3f) mm\n",
              median(errors.position) / kMillimetre, rms(errors.position) / kMillimetre,
              errors.predicted() / kMillimetre);
  EXPECT_LT(median(errors.position), kPaper);
  EXPECT_LT(errors.mean_nees(), kHonest);
  // The reason for the default.
  EXPECT_LT(rms(full_errors.position), rms(errors.position));
}

TEST_F(Recordings, RealBoardIsLocalisedAsItsAuthorsFitOrBetter) {
  // SOURCE.txt: 0.25 to 0.39 mm and 0.7 to 1.1 degree in the mean, 1.04 mm at most.
  constexpr double kMean = 0.39 * kMillimetre;
  constexpr double kMost = 1.04 * kMillimetre;
  constexpr double kAxis = 1.1 * kDegree;
  for (const int run : {1, 2, 3}) {
    SCOPED_TRACE(run);
    const test::Recording recording = test::read_magnet_board(data_ / "magnet_board", run);
    ASSERT_EQ(recording.readings.size(), 63U);
    Errors errors;
    MagneticLocalizer localizer(recording.rig);
    for (const test::RecordedReading& reading : recording.readings) {
      const MagneticFix fix = localizer.localize(reading.hall, reading.currents);
      EXPECT_EQ(fix.status, FixStatus::kOk);
      errors.add(*reading.truth, fix);
    }
    std::printf(
        "board run %d: position mean %.3f max %.3f (predicted %.3f) mm, axis mean %.2f "
        "degree, NEES/5 %.2f\n",
        run, mean(errors.position) / kMillimetre,
        *std::max_element(errors.position.begin(), errors.position.end()) / kMillimetre,
        errors.predicted() / kMillimetre, mean(errors.axis) / kDegree, errors.mean_nees());
    EXPECT_LT(mean(errors.position), kMean);
    EXPECT_LT(*std::max_element(errors.position.begin(), errors.position.end()), kMost);
    EXPECT_LT(mean(errors.axis), kAxis);
  }
}

TEST_F(Recordings, UncalibratedSensorsWithAnUnknownMagnetNeverGiveAnythingUndefined) {
  int readings = 0;
  for (const auto& entry : std::filesystem::directory_iterator(data_ / "magnetometer_10")) {
    if (entry.path().extension() != ".csv") continue;
    test::Recording recording = test::read_magnetometer_10(entry.path());
    recording.rig.magnet.moment = 0.01;  // a finger magnet's order of size
    recording.rig.magnet.moment_std = 0.01;
    recording.rig.hall_array.offset_std = 30e-6;  // SOURCE.txt: hard iron not calibrated
    recording.rig.magnetic_localizer.search_half_width = 0.05;
    recording.rig.magnetic_localizer.search_depth = 0.1;
    MagneticLocalizer localizer(recording.rig);
    for (const test::RecordedReading& reading : recording.readings) {
      const MagneticFix fix = localizer.localize(reading.hall, reading.currents);
      EXPECT_TRUE(fix.state.position.allFinite());
      EXPECT_TRUE(fix.state.background.allFinite());
      EXPECT_EQ(fix.covariance.llt().info(), Eigen::Success);
      ++readings;
    }
  }
  EXPECT_GT(readings, 300);  // SOURCE.txt: 25 to 45 rows in each of twelve files
}

}  // namespace
}  // namespace gastronaut

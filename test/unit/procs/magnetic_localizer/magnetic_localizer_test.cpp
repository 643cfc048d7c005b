#include "magnetic_localizer/magnetic_localizer.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>

#include "unit/procs/magnetic_localizer/simulated_array.hpp"

namespace gastronaut::magnetics {
namespace {

using test::Draws;

constexpr double kDegree = std::numbers::pi / 180;
// Where a capsule is in use: 30 to 100 mm below the array.
constexpr double kNear = 0.03;
constexpr double kFar = 0.10;
constexpr double kHalfWidth = 0.06;
// The target: within 5 cm of the array 0.5 mm and 1 degree.
constexpr double kTargetDepth = 0.05;
constexpr double kTargetPosition = 0.5e-3;
constexpr double kTargetAxis = 1 * kDegree;

MagneticFix localize_once(const RigConfiguration& rig, const HallReading& reading) {
  return MagneticLocalizer(rig).localize(reading, std::nullopt);
}

double position_variance(const Matrix5d& covariance) {
  return covariance.topLeftCorner<3, 3>().trace();
}

// The bound (J^T S^-1 J)^-1 for white noise, from the scalar field derivatives in common/.
Matrix5d cramer_rao_bound(const RigConfiguration& rig, const MagnetState& state) {
  using Matrix8 = Eigen::Matrix<double, 8, 8>;
  Matrix8 information = Matrix8::Zero();
  const Eigen::Matrix<double, 3, 2> basis = perpendicular_basis(state.axis);
  for (const HallSensorConfiguration& sensor : rig.hall_array.resolved_sensors()) {
    const AxialMagnetDerivatives derivatives =
        axial_magnet_derivatives(sensor.position - state.position, state.moment * state.axis,
                                 octupole_ratio(rig.magnet.shape()));
    Eigen::Matrix<double, 3, 8> by_unknown;
    by_unknown << -derivatives.by_offset,
        derivatives.by_moment * state.moment * -skew(state.axis) * basis,
        Eigen::Matrix3d::Identity();
    const Eigen::MatrixXd measured = sensor.response * by_unknown;
    information += measured.transpose() * measured / (rig.hall_array.noise * rig.hall_array.noise);
  }
  return information.inverse().topLeftCorner<5, 5>();
}

RigConfiguration mono_axial(RigConfiguration rig) {
  rig.hall_array.num_axes = 1;
  return rig;
}

// Mean of the normalised estimation error squared over poses and sensor errors, per degree of
// freedom.
double mean_nees(const RigConfiguration& rig, int count, double most_depth) {
  double sum = 0;
  int fixes = 0;
  for (int i = 0; i < count; ++i) {
    Draws draws(7, static_cast<std::uint64_t>(i));
    const MagnetState truth = test::random_state(rig, draws, kHalfWidth, kNear, most_depth);
    MagnetState real = truth;
    real.moment += rig.magnet.moment_std * draws.normal();
    const HallArrayConfiguration sensors =
        test::with_sensor_errors(rig.hall_array, static_cast<std::uint64_t>(i));
    const MagneticFix fix =
        localize_once(rig, test::simulate_reading(sensors, rig.magnet, real, &draws));
    EXPECT_EQ(fix.status, FixStatus::kOk) << "pose " << i;
    if (fix.status != FixStatus::kOk) continue;
    const Vector5d error = test::pose_error(truth.position, truth.axis, fix.state);
    sum += error.dot(fix.covariance.llt().solve(error));
    ++fixes;
  }
  return sum / (5 * fixes);
}

TEST(MagneticLocalizer, FindsTheRightBasinWithoutAnyPriorAnywhereInTheBox) {
  constexpr double kNoiseFree =
      1e-9;  // tesla: the smallest signal in the box is a hundred times it
  constexpr double kSameBasin = 0.1e-3;  // metres: thousands of times the noise, no local minimum
  for (const bool single_axis : {false, true}) {
    RigConfiguration rig = test::exact_rig();
    if (single_axis) rig = mono_axial(rig);
    rig.hall_array.noise = kNoiseFree;
    rig.hall_array.saturation = 1;
    const MagneticLocalizerConfiguration& box = rig.magnetic_localizer;
    for (int i = 0; i < 200; ++i) {
      Draws draws(1, static_cast<std::uint64_t>(i));
      const MagnetState truth =
          test::random_state(rig, draws, box.search_half_width, 0.015, box.search_depth);
      const MagneticFix fix =
          localize_once(rig, test::simulate_reading(rig.hall_array, rig.magnet, truth, nullptr));
      EXPECT_LT((fix.state.position - truth.position).norm(), kSameBasin)
          << "pose " << i << " at " << truth.position.transpose() << " axis "
          << truth.axis.transpose() << (single_axis ? ", one axis" : ", three axes") << " status "
          << static_cast<int>(fix.status) << " chi2 " << fix.chi2_per_dof;
    }
  }
}

TEST(MagneticLocalizer, FindsTheRightBasinFromNoisyReadingsOfImperfectSensors) {
  RigConfiguration rig;
  const MagneticLocalizerConfiguration& box = rig.magnetic_localizer;
  constexpr double kSigmas = 6;
  constexpr double kHeard = 0.12;  // metres: the magnet is heard for certain down to here
  int num_ok = 0;
  constexpr int kNumPoses = 200;
  for (int i = 0; i < kNumPoses; ++i) {
    Draws draws(2, static_cast<std::uint64_t>(i));
    const MagnetState truth =
        test::random_state(rig, draws, box.search_half_width, 0.025, box.search_depth);
    const HallArrayConfiguration sensors =
        test::with_sensor_errors(rig.hall_array, static_cast<std::uint64_t>(i));
    const MagneticFix fix =
        localize_once(rig, test::simulate_reading(sensors, rig.magnet, truth, &draws));
    const bool heard = truth.position.head<2>().norm() < kHalfWidth &&
                       truth.position.z() > rig.hall_array.z - kHeard;
    if (!heard && fix.status == FixStatus::kTooFar) continue;
    EXPECT_EQ(fix.status, FixStatus::kOk) << "pose " << i << " chi2 " << fix.chi2_per_dof;
    const double predicted = std::sqrt(position_variance(fix.covariance));
    EXPECT_LT((fix.state.position - truth.position).norm(), kSigmas * predicted) << "pose " << i;
    ++num_ok;
  }
  EXPECT_GT(num_ok, kNumPoses / 5);  // most of the box is out of hearing, but not all
}

TEST(MagneticLocalizer, ReachesTheCramerRaoBoundWhenTheModelIsExact) {
  constexpr double kAllowed = 1.1;          // targets.md
  constexpr double kSamePrediction = 0.03;  // the bound at the estimate against that at the truth
  constexpr int kNumSeeds = 500;            // the ratio of RMS values spreads by 2 %
  const RigConfiguration rig = test::exact_rig();
  MagnetState truth;
  truth.position = {0.02, -0.015, 0.01};
  truth.axis = Eigen::Vector3d(0.6, -0.5, 0.4).normalized();
  truth.moment = rig.magnet.moment;
  const Matrix5d bound = cramer_rao_bound(rig, truth);
  MagneticLocalizer localizer(rig);
  Matrix5d scatter = Matrix5d::Zero();
  for (int seed = 0; seed < kNumSeeds; ++seed) {
    Draws draws(3, static_cast<std::uint64_t>(seed));
    const MagneticFix fix = localizer.localize(
        test::simulate_reading(rig.hall_array, rig.magnet, truth, &draws), std::nullopt);
    ASSERT_EQ(fix.status, FixStatus::kOk);
    const Vector5d error = test::pose_error(truth.position, truth.axis, fix.state);
    scatter += error * error.transpose() / kNumSeeds;
    if (fix.chi2_per_dof < 1) {
      EXPECT_NEAR(std::sqrt(position_variance(fix.covariance) / position_variance(bound)), 1,
                  kSamePrediction);
    }
  }
  const double position_ratio =
      std::sqrt(scatter.topLeftCorner<3, 3>().trace() / bound.topLeftCorner<3, 3>().trace());
  const double axis_ratio = std::sqrt(scatter.bottomRightCorner<2, 2>().trace() /
                                      bound.bottomRightCorner<2, 2>().trace());
  RecordProperty("position_over_bound", std::to_string(position_ratio));
  RecordProperty("axis_over_bound", std::to_string(axis_ratio));
  EXPECT_LT(position_ratio, kAllowed);
  EXPECT_LT(axis_ratio, kAllowed);
}

TEST(MagneticLocalizer, CovarianceIsHonestWithSensorErrors) {
  // 95 % band of the mean of 300 chi-square values of five degrees of freedom is 0.93 to 1.07;
  // what is beyond it allows for the model's curvature.
  constexpr double kLow = 0.88;
  constexpr double kHigh = 1.12;
  constexpr int kNumPoses = 300;
  const double three_axes = mean_nees(RigConfiguration(), kNumPoses, kFar);
  EXPECT_GT(three_axes, kLow);
  EXPECT_LT(three_axes, kHigh);
  const double one_axis = mean_nees(mono_axial(RigConfiguration()), kNumPoses, kFar);
  EXPECT_GT(one_axis, kLow);
  EXPECT_LT(one_axis, kHigh);
}

TEST(MagneticLocalizer, SecondDifferencesGiveAnHonestCovarianceToo) {
  constexpr double kLow = 0.85;
  constexpr double kHigh = 1.15;  // the band of 150 poses
  constexpr int kNumPoses = 150;
  constexpr double kMostDepth = 0.07;  // their signal falls with the fifth power of the distance
  RigConfiguration rig;
  rig.magnetic_localizer.estimator = MagneticEstimator::kSecondDifference;
  rig.magnetic_localizer.max_position_std = 0.02;
  const double nees = mean_nees(rig, kNumPoses, kMostDepth);
  EXPECT_GT(nees, kLow);
  EXPECT_LT(nees, kHigh);
}

TEST(MagneticLocalizer, MeetsTheTargetWithinFiveCentimetres) {
  const RigConfiguration rig;
  constexpr int kNumPoses = 200;
  double position_square = 0;
  double axis_square = 0;
  for (int i = 0; i < kNumPoses; ++i) {
    Draws draws(4, static_cast<std::uint64_t>(i));
    const MagnetState truth = test::random_state(rig, draws, kHalfWidth, kNear, kTargetDepth);
    const HallArrayConfiguration sensors =
        test::with_sensor_errors(rig.hall_array, static_cast<std::uint64_t>(i));
    const MagneticFix fix =
        localize_once(rig, test::simulate_reading(sensors, rig.magnet, truth, &draws));
    ASSERT_EQ(fix.status, FixStatus::kOk);
    const Vector5d error = test::pose_error(truth.position, truth.axis, fix.state);
    position_square += error.head<3>().squaredNorm() / kNumPoses;
    axis_square += error.tail<2>().squaredNorm() / kNumPoses;
  }
  RecordProperty("position_rms_mm", std::to_string(1e3 * std::sqrt(position_square)));
  RecordProperty("axis_rms_degree", std::to_string(std::sqrt(axis_square) / kDegree));
  EXPECT_LT(std::sqrt(position_square), kTargetPosition);
  EXPECT_LT(std::sqrt(axis_square), kTargetAxis);
}

class FaultyReadings : public ::testing::TestWithParam<MagneticEstimator> {
 protected:
  FaultyReadings() {
    rig_.magnetic_localizer.estimator = GetParam();
    truth_.position = {0.01, -0.02, 0.04};
    truth_.axis = Eigen::Vector3d(0.5, 0.3, -0.8).normalized();
    truth_.moment = rig_.magnet.moment;
    truth_.background = {18e-6, -6e-6, -42e-6};
  }
  HallReading reading(const test::ForeignDipole& foreign = {}) {
    return test::simulate_reading(rig_.hall_array, rig_.magnet, truth_, &draws_, foreign);
  }
  // Whether the fix is as near the truth as its own covariance says.
  void expect_good(const MagneticFix& fix) const {
    constexpr double kSigmas = 5;
    EXPECT_EQ(fix.status, FixStatus::kOk);
    const Vector5d error = test::pose_error(truth_.position, truth_.axis, fix.state);
    EXPECT_LT(error.dot(fix.covariance.llt().solve(error)), kSigmas * kSigmas);
    EXPECT_LT(error.head<3>().norm(), kGoodFix);
  }
  static constexpr double kGoodFix = 3e-3;  // metres: five times the weaker estimator's error here

  RigConfiguration rig_;
  MagnetState truth_;
  Draws draws_{5, 0};
};

TEST_P(FaultyReadings, WrongSensorsAreLeftOutColdAndWarm) {
  MagneticLocalizer localizer(rig_);
  for (int repeat = 0; repeat < 3; ++repeat) {
    HallReading faulty = reading();
    // Stuck at a value, at zero, and with the sign of one axis turned.
    faulty.field.segment<3>(3 * 9).setConstant(2e-3);
    faulty.field.segment<3>(3 * 28).setZero();
    faulty.field[3 * 45 + 2] *= -1;
    const MagneticFix fix = localizer.localize(faulty, std::nullopt);
    expect_good(fix);
    EXPECT_EQ(fix.num_channels_used, 3 * (64 - 3));
  }
}

TEST_P(FaultyReadings, FlaggedSaturatedAndUndefinedChannelsAreNotUsed) {
  HallReading faulty = reading();
  faulty.status[3] = 1;
  faulty.status[30] = 4;
  faulty.field[3 * 20] = rig_.hall_array.saturation;
  faulty.field[3 * 21 + 1] = -1;  // tesla
  faulty.field[3 * 40 + 1] = std::numeric_limits<double>::quiet_NaN();
  faulty.field[3 * 41 + 2] = std::numeric_limits<double>::infinity();
  const MagneticFix fix = localize_once(rig_, faulty);
  expect_good(fix);
  EXPECT_EQ(fix.num_channels_used, 3 * 64 - 2 * 3 - 4);
}

TEST_P(FaultyReadings, TooManyBadSensorsReportSaturated) {
  HallReading faulty = reading();
  faulty.status.head(33).setConstant(1);
  const MagneticFix fix = localize_once(rig_, faulty);
  EXPECT_EQ(fix.status, FixStatus::kSaturated);
  EXPECT_GT(fix.covariance(0, 0), 0.01);  // metres^2: anywhere in the box
}

TEST_P(FaultyReadings, FarMagnetReportsTooFarInsteadOfAGuess) {
  MagneticLocalizer localizer(rig_);
  expect_good(localizer.localize(reading(), std::nullopt));
  truth_.position.z() = -1;  // metres
  for (int repeat = 0; repeat < 5; ++repeat) {
    const MagneticFix fix = localizer.localize(reading(), std::nullopt);
    EXPECT_EQ(fix.status, FixStatus::kTooFar);
    const double limit = rig_.magnetic_localizer.max_position_std;
    EXPECT_GT(position_variance(fix.covariance), limit * limit);
  }
  truth_.position.z() = 0.03;  // back
  expect_good(localizer.localize(reading(), std::nullopt));
}

TEST_P(FaultyReadings, ForeignDipoleReportsInterferenceAndRecovers) {
  MagneticLocalizer localizer(rig_);
  expect_good(localizer.localize(reading(), std::nullopt));
  const MagneticFix disturbed = localizer.localize(reading({{0.10, 0.08, 0.15}, {0, 8, 6}}),
                                                   std::nullopt);  // a strong magnet 15 cm away
  EXPECT_EQ(disturbed.status, FixStatus::kInterference);
  EXPECT_GT(disturbed.covariance(0, 0), 0.01);
  expect_good(localizer.localize(reading(), std::nullopt));
}

TEST_P(FaultyReadings, MissingCurrentsAreSaidAndNeverPassForAGoodFix) {
  rig_.coils.tesla_per_ampere = Eigen::MatrixXd::Constant(3 * 64, 2, 2e-5);
  rig_.coils.tesla_per_ampere.topRows(96) *= -1;
  MagneticLocalizer localizer(rig_);
  const Eigen::Vector2d currents(3, -1);
  HallReading driven = reading();
  driven.field += rig_.coils.tesla_per_ampere * currents;
  expect_good(localizer.localize(driven, currents));
  const MagneticFix blind = localizer.localize(driven, std::nullopt);
  EXPECT_EQ(blind.status, FixStatus::kNoCurrents);
  EXPECT_GT(blind.covariance(0, 0), 0.01);
  expect_good(localizer.localize(driven, currents));
}

INSTANTIATE_TEST_SUITE_P(Estimators, FaultyReadings,
                         ::testing::Values(MagneticEstimator::kFullField,
                                           MagneticEstimator::kSecondDifference),
                         [](const auto& test) {
                           return std::string(test.param == MagneticEstimator::kFullField
                                                  ? "FullField"
                                                  : "SecondDifference");
                         });

TEST(MagneticLocalizer, AFixDependsOnItsReadingAloneNotOnTheOneBefore) {
  // Of the standard deviation: the noise is weighed with the field expected from the fix before.
  constexpr double kStartingPointForgotten = 0.05;
  const RigConfiguration rig;
  Draws draws(6, 0);
  MagnetState truth = test::random_state(rig, draws, kHalfWidth, kNear, kFar);
  MagneticLocalizer warm(rig);
  for (int i = 0; i < 20; ++i) {
    truth.position.x() += 0.5e-3;
    truth.axis = (truth.axis + 0.02 * draws.direction()).normalized();
    const HallReading reading = test::simulate_reading(rig.hall_array, rig.magnet, truth, &draws);
    const MagneticFix fix = warm.localize(reading, std::nullopt);
    const MagneticFix alone = localize_once(rig, reading);
    const double deviation = std::sqrt(position_variance(alone.covariance));
    EXPECT_LT((fix.state.position - alone.state.position).norm(),
              kStartingPointForgotten * deviation);
  }
}

TEST(MagneticLocalizer, WorksWithSensorsInAnyPose) {
  // A bowl of sensors that all look in different directions.
  RigConfiguration rig;
  Draws draws(8, 0);
  for (int i = 0; i < 40; ++i) {
    HallSensorConfiguration sensor;
    const double x = draws.uniform(-0.08, 0.08);
    const double y = draws.uniform(-0.08, 0.08);
    sensor.position = {x, y, 0.08 - 5 * (x * x + y * y)};
    sensor.response =
        so3_exp(std::numbers::pi * draws.uniform(0, 1) * draws.direction()).toRotationMatrix();
    rig.hall_array.sensors.push_back(sensor);
  }
  constexpr double kSigmas = 5;
  for (int i = 0; i < 50; ++i) {
    const MagnetState truth = test::random_state(rig, draws, 0.03, 0.09, 0.13);
    const MagneticFix fix =
        localize_once(rig, test::simulate_reading(rig.hall_array, rig.magnet, truth, &draws));
    EXPECT_EQ(fix.status, FixStatus::kOk);
    const Vector5d error = test::pose_error(truth.position, truth.axis, fix.state);
    EXPECT_LT(error.dot(fix.covariance.llt().solve(error)), kSigmas * kSigmas);
  }
}

}  // namespace
}  // namespace gastronaut::magnetics

#include "calibrate/array_calibration.hpp"

#include <gmock/gmock.h>

#include "array_simulation.hpp"
#include "calibrate/missing_motion.hpp"
#include "calibrate/uniform_field.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut {
namespace {

using testing::AllOf;
using testing::HasSubstr;

const ArrayPriors kPriors;  // the errors are drawn from what the calibration believes of them

ArrayCalibration calibrate(const RigConfiguration& rig,
                           const std::vector<CalibrationReading>& readings) {
  return calibrate_array(rig, readings, {}, [](double) {});
}

std::string refusal(const RigConfiguration& rig, const SimulatedRun& run,
                    const RigConfiguration& truth) {
  try {
    calibrate(rig, simulate(truth, run));
  } catch (const CalibrationRefused& refused) {
    return refused.what();
  }
  return "accepted";
}

// Squared errors in units of the variances that the calibration gives itself, and plain.
struct Consistency {
  double gain = 0, alignment = 0, offset = 0;              // mean normalised squares
  double gain_rms = 0, alignment_rms = 0, offset_rms = 0;  // relative, radians, tesla
  double moment = 0;                                       // normalised
};

// Readings without magnet and currents, less what a uniform field makes of them.
Eigen::VectorXd offset_pattern(const RigConfiguration& nominal, const RigConfiguration& rig,
                               const Eigen::Vector3d& background) {
  const Eigen::Index num_axes = rig.hall_array.num_axes;
  Eigen::MatrixXd responses(rig.hall_array.num_sensors() * num_axes, 3);
  Eigen::VectorXd readings(responses.rows());
  for (Eigen::Index c = 0; c < readings.size(); ++c) {
    const auto sensor = static_cast<std::size_t>(c / num_axes);
    const Eigen::Index axis = c % num_axes;
    responses.row(c) = nominal.hall_array.sensors[sensor].response.row(axis);
    readings(c) = rig.hall_array.sensors[sensor].offset[static_cast<std::size_t>(axis)] +
                  rig.hall_array.sensors[sensor].response.row(axis) * background;
  }
  return readings - responses * uniform_field(responses, readings);
}

Consistency consistency(const RigConfiguration& nominal, const RigConfiguration& truth,
                        const ArrayCalibration& calibration) {
  Consistency result;
  const Eigen::VectorXd offset_errors =
      offset_pattern(nominal, calibration.rig, calibration.background) -
      offset_pattern(nominal, truth, SimulatedRun().background);
  std::size_t channel = 0;
  for (std::size_t s = 0; s < truth.hall_array.sensors.size(); ++s) {
    const Eigen::MatrixXd difference =
        calibration.rig.hall_array.sensors[s].response - truth.hall_array.sensors[s].response;
    for (Eigen::Index axis = 0; axis < difference.rows(); ++axis, ++channel) {
      const Eigen::RowVector3d along =
          nominal.hall_array.sensors[s].response.row(axis).normalized();
      const double gain = difference.row(axis).dot(along);
      const double across = (difference.row(axis) - gain * along).squaredNorm() / 2;
      const double offset = offset_errors(static_cast<Eigen::Index>(channel));
      const auto& deviation = calibration.deviations[channel];
      result.gain += std::pow(gain / deviation.gain, 2);
      result.alignment += across / std::pow(deviation.alignment, 2);
      result.offset += std::pow(offset / deviation.offset, 2);
      result.gain_rms += gain * gain;
      result.alignment_rms += across;
      result.offset_rms += offset * offset;
    }
  }
  const auto channels = static_cast<double>(channel);
  result.gain /= channels;
  result.alignment /= channels;
  result.offset /= channels;
  result.gain_rms = std::sqrt(result.gain_rms / channels);
  result.alignment_rms = std::sqrt(result.alignment_rms / channels);
  result.offset_rms = std::sqrt(result.offset_rms / channels);
  result.moment =
      (calibration.rig.magnet.moment - truth.magnet.moment) / calibration.rig.magnet.moment_std;
  return result;
}

struct Case {
  const char* name;
  int num_axes;
  bool known_poses;
};
class ArrayCalibrationOfEveryKind : public testing::TestWithParam<Case> {};

TEST_P(ArrayCalibrationOfEveryKind, ErrsAsMuchAsItSaysAndFarLessThanBefore) {
  const RigConfiguration rig = simulated_rig(GetParam().num_axes);
  constexpr int kSeeds = 4;
  Consistency mean;
  for (int seed = 1; seed <= kSeeds; ++seed) {
    const RigConfiguration truth =
        with_sensor_errors(rig, kPriors, static_cast<std::uint64_t>(seed));
    SimulatedRun run{wide_path, independent_currents};
    run.seed = static_cast<std::uint64_t>(seed);
    run.known_poses = GetParam().known_poses;
    const ArrayCalibration calibration = calibrate(rig, simulate(truth, run));
    const Consistency one = consistency(rig, truth, calibration);
    mean.gain += one.gain / kSeeds;
    mean.alignment += one.alignment / kSeeds;
    mean.offset += one.offset / kSeeds;
    mean.gain_rms += one.gain_rms / kSeeds;
    mean.alignment_rms += one.alignment_rms / kSeeds;
    mean.offset_rms += one.offset_rms / kSeeds;
    constexpr double kFourSigmas = 4;
    EXPECT_LT(std::abs(one.moment), kFourSigmas);
    constexpr double kChi2Band = 0.1;  // five sigmas of chi2 per degree with 5000 degrees
    EXPECT_NEAR(calibration.chi2_per_dof, 1, kChi2Band);
    constexpr double kNoOverfit = 1.1;  // residuals of unseen readings are the noise
    EXPECT_LT(calibration.held_out_rms_after, kNoOverfit * rig.hall_array.noise);
    EXPECT_GT(calibration.held_out_rms_before, 2 * calibration.held_out_rms_after);
  }
  // Errors of the channels hang together through poses and moment: the means of 64 or more
  // squares scatter more widely than the square root of their number says.
  constexpr double kLeastNees = 0.6;
  constexpr double kMostNees = 1.5;
  for (const double nees : {mean.gain, mean.alignment, mean.offset}) {
    EXPECT_GT(nees, kLeastNees);
    EXPECT_LT(nees, kMostNees);
  }
  constexpr double kWorthwhile = 0.7;  // of the prior
  EXPECT_LT(mean.gain_rms, kWorthwhile * kPriors.gain_std);
  EXPECT_LT(mean.alignment_rms, kWorthwhile * kPriors.alignment_std);
  EXPECT_LT(mean.offset_rms, kWorthwhile * kPriors.offset_std);
}

INSTANTIATE_TEST_SUITE_P(, ArrayCalibrationOfEveryKind,
                         testing::Values(Case{"ThreeAxesKnownPoses", 3, true},
                                         Case{"ThreeAxesUnknownPoses", 3, false},
                                         Case{"OneAxisKnownPoses", 1, true},
                                         Case{"OneAxisUnknownPoses", 1, false}),
                         [](const auto& test) { return std::string(test.param.name); });

class ArrayCalibrationTest : public testing::Test {
 protected:
  const RigConfiguration rig_ = simulated_rig(3);
  const RigConfiguration truth_ = with_sensor_errors(rig_, kPriors, 7);
  SimulatedRun run_{wide_path, independent_currents};
};

TEST_F(ArrayCalibrationTest, MendsACoilMatrixThatLeavesTheSensorsErrorsOut) {
  const ArrayCalibration calibration = calibrate(rig_, simulate(truth_, run_));
  const double before = (rig_.coils.tesla_per_ampere - truth_.coils.tesla_per_ampere).norm();
  const double after =
      (calibration.rig.coils.tesla_per_ampere - truth_.coils.tesla_per_ampere).norm();
  constexpr double kMended = 0.2;
  EXPECT_LT(after, kMended * before);
}

TEST_F(ArrayCalibrationTest, LeavesAMeasuredCoilMatrixAsItIs) {
  RigConfiguration rig = rig_;
  rig.coils = truth_.coils;
  const ArrayCalibration calibration = calibrate(rig, simulate(truth_, run_));
  const double change =
      (calibration.rig.coils.tesla_per_ampere - truth_.coils.tesla_per_ampere).norm() /
      truth_.coils.tesla_per_ampere.norm();
  // Noise against the drive of 1.4 A rms in each coil; the held-out fifth is not used.
  const double entry = rig.hall_array.noise / (1.4 * std::sqrt(0.8 * run_.readings));
  const double relative = entry / std::sqrt(truth_.coils.tesla_per_ampere.cwiseAbs2().mean());
  constexpr double kChance = 1.3;
  EXPECT_LT(change, kChance * relative);
  EXPECT_LT(change, kPriors.gain_std / 2);
}

TEST_F(ArrayCalibrationTest, GivesTheUniformBackgroundItsOwn) {
  const ArrayCalibration calibration = calibrate(rig_, simulate(truth_, run_));
  // Offsets of 16 sensors scatter by 5 uT: their mean, which belongs to neither, by 1.25 uT.
  const double split = kPriors.offset_std / std::sqrt(16);
  constexpr double kFourSigmas = 4;
  EXPECT_LT((calibration.background - run_.background).norm(), kFourSigmas * std::sqrt(3) * split);
}

TEST_F(ArrayCalibrationTest, WorksWithoutCoils) {
  RigConfiguration rig = rig_;
  RigConfiguration truth = truth_;
  rig.coils.tesla_per_ampere.resize(0, 0);
  truth.coils.tesla_per_ampere.resize(rig.hall_array.num_sensors() * 3, 0);
  run_.currents = [](double) { return Eigen::VectorXd(); };
  const ArrayCalibration calibration = calibrate(rig, simulate(truth, run_));
  constexpr double kBetter = 0.5;
  EXPECT_LT(consistency(rig, truth, calibration).offset_rms, kBetter * kPriors.offset_std);
}

TEST_F(ArrayCalibrationTest, IsTheSameToTheBitWithOneThreadAndWithTwo) {
  const auto readings = simulate(truth_, run_);
  set_thread_count(1);
  const std::string one = write_configuration(calibrate(rig_, readings).rig);
  set_thread_count(2);
  const std::string two = write_configuration(calibrate(rig_, readings).rig);
  set_thread_count(0);
  EXPECT_EQ(one, two);
}

TEST_F(ArrayCalibrationTest, LeavesReadingsWithAForeignFieldOut) {
  auto readings = simulate(truth_, run_);
  const Eigen::Vector3d foreign(0, 60e-6, 20e-6);  // tesla, as a steel tool brings with it
  constexpr std::size_t kFrom = 40;
  constexpr std::size_t kTo = 60;
  for (std::size_t i = kFrom; i < kTo; ++i) {
    for (Eigen::Index c = 0; c < readings[i].field.size(); ++c) {
      readings[i].field(c) += foreign(c % 3);
    }
  }
  const ArrayCalibration calibration = calibrate(rig_, readings);
  EXPECT_GT(calibration.readings_left_out, 0);
  EXPECT_LE(calibration.readings_left_out, static_cast<int>(kTo - kFrom));
  constexpr double kChi2Band = 0.1;
  EXPECT_NEAR(calibration.chi2_per_dof, 1, kChi2Band);
}

TEST_F(ArrayCalibrationTest, IsNotMisledByChannelsThatAreNowAndThenWrong) {
  auto readings = simulate(truth_, run_);
  const double before = consistency(rig_, truth_, calibrate(rig_, readings)).offset_rms;
  constexpr std::size_t kEvery = 7;
  const double wrong = 300e-6;  // tesla
  for (std::size_t i = 0; i < readings.size(); i += kEvery) {
    readings[i].field(static_cast<Eigen::Index>(i % 48)) += wrong;
  }
  const double after = consistency(rig_, truth_, calibrate(rig_, readings)).offset_rms;
  constexpr double kHardlyWorse = 1.2;
  EXPECT_LT(after, kHardlyWorse * before);
}

TEST_F(ArrayCalibrationTest, RefusesAMagnetThatRests) {
  run_.path = [](double) { return MagnetPose{{0.01, 0, 0}, Eigen::Vector3d::UnitZ()}; };
  EXPECT_THAT(refusal(rig_, run_, truth_),
              AllOf(HasSubstr("does not determine the array"), HasSubstr("about x and y"),
                    testing::ContainsRegex("only [0-9] mm along x"),
                    testing::ContainsRegex("only [0-9] mm along y")));
}

TEST_F(ArrayCalibrationTest, RefusesAShortPathWithoutTurningAndSaysWhatToTurnAndMove) {
  run_.path = [](double phase) {
    MagnetPose pose = wide_path(phase);
    pose.position *= 0.05;
    pose.axis = (Eigen::Vector3d::UnitX() + 0.1 * pose.axis).normalized();
    return pose;
  };
  EXPECT_THAT(refusal(rig_, run_, truth_),
              AllOf(HasSubstr("degrees of x"), HasSubstr("about y and z"), HasSubstr("mm along x"),
                    HasSubstr("mm along y")));
}

TEST_F(ArrayCalibrationTest, NamesTheSensorsThatNeverSawTheMagnet) {
  RigConfiguration rig = rig_;
  constexpr double kAway = 0.35;  // metres: there the magnet makes less than 3 uT
  for (std::size_t s = 12; s < 16; ++s) rig.hall_array.sensors[s].position.x() += kAway;
  rig.coils.tesla_per_ampere.resize(0, 0);
  RigConfiguration truth = with_sensor_errors(rig, kPriors, 3);
  truth.coils.tesla_per_ampere.setZero(48, 0);
  run_.currents = [](double) { return Eigen::VectorXd(); };
  EXPECT_THAT(refusal(rig, run_, truth),
              AllOf(HasSubstr("sensors 12-15 (+x side)"), HasSubstr("uT of the magnet")));
}

TEST_F(ArrayCalibrationTest, RefusesTooFewReadings) {
  run_.readings = 40;
  EXPECT_THAT(refusal(rig_, run_, truth_), HasSubstr("record for longer"));
}

TEST_F(ArrayCalibrationTest, RefusesAMagnetOutOfReach) {
  run_.path = [](double phase) {
    MagnetPose pose = wide_path(phase);
    pose.position.z() -= 0.8;
    return pose;
  };
  EXPECT_THAT(refusal(rig_, run_, truth_), testing::Not(HasSubstr("accepted")));
}

TEST_F(ArrayCalibrationTest, RefusesReadingsThatTheMagnetDoesNotExplain) {
  RigConfiguration truth = truth_;
  truth.hall_array.noise *= 5;
  EXPECT_THAT(refusal(rig_, run_, truth), HasSubstr("do not explain the readings"));
}

TEST_F(ArrayCalibrationTest, RefusesKnownPosesThatDisagreeWithTheArray) {
  run_.known_poses = true;
  auto readings = simulate(truth_, run_);
  for (CalibrationReading& reading : readings) reading.known_pose->position.x() += 0.03;
  try {
    calibrate(rig_, readings);
    FAIL() << "accepted";
  } catch (const CalibrationRefused& refused) {
    EXPECT_THAT(refused.what(),
                AllOf(testing::ContainsRegex("(29|3[01]) mm"), HasSubstr("camera_T_magnet")));
  }
}

TEST(MissingMotion, NamesNoSideForSensorsAllOverTheArray) {
  std::vector<Eigen::Vector3d> positions;
  for (const auto& sensor : simulated_rig(3).hall_array.sensors)
    positions.push_back(sensor.position);
  EXPECT_EQ(name_sensors({0, 3, 12, 15}, positions), "sensors 0, 3, 12, 15");
  EXPECT_EQ(name_sensors({3, 7}, positions), "sensors 3, 7 (-x +y side)");
  EXPECT_EQ(name_sensors({0, 1, 2, 3}, positions), "sensors 0-3 (-x side)");
  EXPECT_EQ(name_sensors({5}, positions), "sensor 5");
}

TEST(MissingMotion, IsContentWithAWidePath) {
  std::vector<Eigen::Vector3d> positions;
  for (const auto& sensor : simulated_rig(3).hall_array.sensors)
    positions.push_back(sensor.position);
  std::vector<MagnetPose> poses;
  constexpr int kPoses = 100;
  for (int i = 0; i < kPoses; ++i) poses.push_back(wide_path(static_cast<double>(i) / kPoses));
  EXPECT_THAT(describe_missing_motion(poses, positions), testing::IsEmpty());
}

}  // namespace
}  // namespace gastronaut

#include "calibrate/hand_eye_calibration.hpp"

#include <gmock/gmock.h>

#include <Eigen/Cholesky>

#include "calibrate/calibration_readings.hpp"
#include "unit/procs/calibrate/hand_eye_simulation.hpp"

namespace gastronaut {
namespace {

using testing::AnyOf;
using testing::HasSubstr;

constexpr double kMostGap = 0.2;  // seconds between frames
constexpr double kMilli = 1e-3;

HandEyeCalibration calibrate(const SimulatedHandEye& run) {
  return calibrate_hand_eye(VisualTrack(run.frames, kMostGap), run.fixes, wrong_hand_eye(),
                            [](double) {});
}

std::string refusal(const SimulatedHandEye& run) {
  try {
    calibrate(run);
  } catch (const CalibrationRefused& refused) {
    return refused.what();
  }
  return "not refused";
}

double nees(const HandEyeCalibration& calibration, const Vector5d& error) {
  return error.dot(calibration.covariance.topLeftCorner<5, 5>().llt().solve(error));
}

struct Trials {
  double centre = 0;  // mean norm of the error, metres
  double axis = 0;    // radians
  double nees = 0;    // mean
};

Trials try_stop_and_go(int poses, int seeds) {
  Trials trials;
  for (int seed = 0; seed < seeds; ++seed) {
    const auto number = static_cast<std::uint64_t>(seed);
    const auto calibration =
        calibrate(stop_and_go(true_hand_eye(), random_poses(poses, number), {}, number));
    const Vector5d error = hand_eye_error(calibration.estimate, true_hand_eye());
    trials.centre += error.head<3>().norm() / seeds;
    trials.axis += error.tail<2>().norm() / seeds;
    trials.nees += nees(calibration, error) / seeds;
  }
  std::printf("%d poses, mean of %d seeds: %.3f mm, %.3f degrees, NEES %.2f of 5\n", poses, seeds,
              trials.centre / kMilli, trials.axis / kOneDegree, trials.nees);
  return trials;
}

TEST(HandEyeCalibration, RecoversTheTruthFromTwentyPosesWithACovarianceThatHolds) {
  constexpr int kSeeds = 50;
  const Trials trials = try_stop_and_go(20, kSeeds);
  // What a plain least-squares fit reached (reference-facts.md 6).
  EXPECT_LT(trials.centre, 0.41 * kMilli);
  EXPECT_LT(trials.axis, 0.3 * kOneDegree);
  // 95 % band of chi-squared with 5 x 50 degrees of freedom, a seed.
  EXPECT_GT(trials.nees, 208.1 / kSeeds);
  EXPECT_LT(trials.nees, 295.7 / kSeeds);
}

TEST(HandEyeCalibration, MeetsTheTargetWithEightyPoses) {
  constexpr int kSeeds = 16;
  const Trials trials = try_stop_and_go(80, kSeeds);
  EXPECT_LT(trials.centre, 0.17 * kMilli);  // reference-facts.md 6
  EXPECT_LT(trials.axis, 0.15 * kOneDegree);
  // 95 % band of chi-squared with 5 x 16 degrees of freedom.
  EXPECT_GT(trials.nees, 57.2 / kSeeds);
  EXPECT_LT(trials.nees, 106.6 / kSeeds);
}

TEST(HandEyeCalibration, RecoversScaleAndTimeOffset) {
  HandEye truth = true_hand_eye();
  for (const double offset : {-0.15, 0.03}) {
    truth.time_offset = offset;
    const auto calibration = calibrate(swinging(truth, 12, {}, {}, 7));
    const HandEyeVector sigma = calibration.covariance.diagonal().cwiseSqrt();
    constexpr double kFourSigmas = 4;
    constexpr double kUseful = 2e-3;  // seconds: 0.1 mm at the speed of a capsule
    EXPECT_NEAR(calibration.estimate.time_offset, offset, kFourSigmas * sigma(kTimeOffsetAt));
    EXPECT_LT(sigma(kTimeOffsetAt), kUseful);
    EXPECT_NEAR(std::log(calibration.estimate.scale / truth.scale), 0,
                kFourSigmas * sigma(kLogScaleAt));
    const Vector5d error = hand_eye_error(calibration.estimate, truth);
    EXPECT_LT(error.head<3>().norm(), kCentreTarget);
    EXPECT_LT(error.tail<2>().norm(), kAxisTarget);
  }
}

TEST(HandEyeCalibration, StaysHonestWhenNeighbouringPosesShareTheirErrors) {
  constexpr int kSeeds = 8;
  SharedErrors shared;  // as on the virtual rig, and on a rig with an array not calibrated
  shared.magnetic_position = 0.15 * kMilli;
  shared.magnetic_axis = 0.2 * kOneDegree;
  shared.visual_position = 0.2 * kMilli;
  shared.visual_rotation = 0.2 * kOneDegree;
  double mean = 0;
  for (int seed = 0; seed < kSeeds; ++seed) {
    const auto calibration = calibrate(
        swinging(true_hand_eye(), 12, {}, shared, static_cast<std::uint64_t>(100 + seed)));
    mean += nees(calibration, hand_eye_error(calibration.estimate, true_hand_eye())) / kSeeds;
  }
  std::printf("shared errors: NEES %.2f of 5\n", mean);
  // 95 % band of chi-squared with 5 x 8 degrees of freedom; the shape of the correlation is only
  // guessed, so that the covariance may be up to twice too large.
  EXPECT_GT(mean, 24.4 / kSeeds / 2);
  EXPECT_LT(mean, 59.3 / kSeeds);
}

TEST(HandEyeCalibration, IsNotSpoiltByPosesThatAreWrong) {
  SimulatedHandEye run = stop_and_go(true_hand_eye(), random_poses(60, 3), {}, 3);
  for (std::size_t i = 0; i < run.fixes.size(); i += 8) {  // a foreign magnet
    run.fixes[i].position += Eigen::Vector3d(8, -5, 12) * kMilli;
    run.fixes[i].axis = so3_exp({0.3, 0.2, 0}) * run.fixes[i].axis;
  }
  const auto calibration = calibrate(run);
  EXPECT_EQ(calibration.misfits, 8U);
  const Vector5d error = hand_eye_error(calibration.estimate, true_hand_eye());
  EXPECT_LT(error.head<3>().norm(), kCentreTarget);
  EXPECT_LT(error.tail<2>().norm(), kAxisTarget);
}

TEST(HandEyeCalibration, ForgetsSingleFixesThatAreFarFromTheOthersOfTheirPlace) {
  SimulatedHandEye run = swinging(true_hand_eye(), 10, {}, {}, 5);
  for (std::size_t i = 0; i < run.fixes.size(); i += 10) run.fixes[i].position.z() += 20 * kMilli;
  for (std::size_t i = 5; i < run.fixes.size(); i += 20) {
    run.fixes[i].axis = perpendicular_basis(run.fixes[i].axis).col(1);
  }
  const auto calibration = calibrate(run);
  const Vector5d error = hand_eye_error(calibration.estimate, true_hand_eye());
  EXPECT_LT(error.head<3>().norm(), kCentreTarget);
  EXPECT_LT(error.tail<2>().norm(), kAxisTarget);
}

TEST(HandEyeCalibration, RefusesWhenMostPosesContradictEachOther) {
  SimulatedHandEye run = stop_and_go(true_hand_eye(), random_poses(40, 4), {}, 4);
  const auto lost = random_poses(40, 5);
  for (std::size_t i = 0; i < run.frames.size(); ++i) {
    if (i % 4 < 2) run.frames[i].map_T_camera = lost[i / 2];
  }
  EXPECT_THAT(refusal(run), HasSubstr("the poses contradict each other"));
}

std::vector<SE3> turned_about(const Eigen::Vector3d& axis, bool moving) {
  std::vector<SE3> poses = random_poses(40, 6);
  for (std::size_t i = 0; i < poses.size(); ++i) {
    poses[i].rotation = so3_exp((static_cast<double>(i) / 39 - 0.5) * 2 * axis);
    if (!moving) poses[i].translation.setZero();
  }
  return poses;
}

TEST(HandEyeCalibration, RefusesTranslationAloneAndAsksForRotationsAboutTwoAxes) {
  const std::string text =
      refusal(stop_and_go(true_hand_eye(), turned_about(Eigen::Vector3d::Zero(), true), {}, 6));
  EXPECT_THAT(text, HasSubstr("leaves the magnet's centre along the camera's"));
  EXPECT_THAT(text, HasSubstr("rotate about the camera's"));
  EXPECT_THAT(text, HasSubstr("; about the camera's"));
}

TEST(HandEyeCalibration, RefusesRotationsAboutOneAxisAndAsksForOneAcross) {
  const std::string about_z =
      refusal(stop_and_go(true_hand_eye(), turned_about(Eigen::Vector3d::UnitZ(), true), {}, 6));
  EXPECT_THAT(about_z, HasSubstr("the magnet's centre along the camera's z axis"));
  EXPECT_THAT(about_z, AnyOf(HasSubstr("rotate about the camera's x axis"),
                             HasSubstr("rotate about the camera's y axis")));
  EXPECT_THAT(about_z, testing::Not(HasSubstr("camera's z axis, 1")));
  const std::string about_x =
      refusal(stop_and_go(true_hand_eye(), turned_about(Eigen::Vector3d::UnitX(), true), {}, 6));
  EXPECT_THAT(about_x, HasSubstr("the magnet's centre along the camera's x axis"));
}

TEST(HandEyeCalibration, RefusesRotationsAboutTheMagnetsOwnAxis) {
  const std::string text =
      refusal(stop_and_go(true_hand_eye(), turned_about(true_hand_eye().axis, false), {}, 6));
  EXPECT_THAT(text, HasSubstr("leaves the magnet's"));
  EXPECT_THAT(text, AnyOf(HasSubstr("rotate about the camera's x axis"),
                          HasSubstr("rotate about the camera's y axis")));
}

TEST(HandEyeCalibration, RefusesTooFewPosesAndPosesWithoutFixes) {
  EXPECT_THAT(refusal(stop_and_go(true_hand_eye(), random_poses(5, 1), {}, 1)),
              HasSubstr("only 5 poses"));
  SimulatedHandEye run = stop_and_go(true_hand_eye(), random_poses(30, 1), {}, 1);
  for (MagneticFix& fix : run.fixes) fix.time += 0.5;  // between the stands
  EXPECT_THAT(refusal(run), HasSubstr("only 0 poses"));
}

TEST(HandEyeCalibration, SaysHowManyMorePosesReachTheTargetAndTheyDo) {
  // Little rotation about x: known, but not to the target.
  std::vector<SE3> poses = random_poses(30, 8);
  for (SE3& pose : poses) {
    const Eigen::Vector3d turn = so3_log(pose.rotation);
    pose.rotation = so3_exp({0.15 * turn.x(), 0.3 * turn.y(), turn.z()});
  }
  const auto before = calibrate(stop_and_go(true_hand_eye(), poses, {}, 8));
  ASSERT_GT(before.advice.sigma, 1);
  EXPECT_THAT(before.advice.motion, HasSubstr("more pose"));
  for (int axis = 0; axis < 3; ++axis) {
    for (int i = 0; i < before.advice.more_poses[static_cast<std::size_t>(axis)]; ++i) {
      SE3 pose = poses[15];
      pose.rotation = pose.rotation *
                      so3_exp((i % 2 == 0 ? 30 : -30) * kOneDegree * Eigen::Vector3d::Unit(axis));
      pose.translation += 1e-3 * Eigen::Vector3d::Constant(i);
      poses.push_back(pose);
    }
  }
  const auto after = calibrate(stop_and_go(true_hand_eye(), poses, {}, 9));
  constexpr double kAsPredicted = 1.25;  // the errors' size is estimated from 30 poses
  EXPECT_LT(after.advice.sigma, kAsPredicted);
  EXPECT_LT(after.advice.sigma, before.advice.sigma);
}

TEST(HandEyeCalibration, LeavingOutPosesSpreadsAsTheCovarianceSays) {
  const auto calibration = calibrate(stop_and_go(true_hand_eye(), random_poses(80, 2), {}, 2));
  EXPECT_EQ(calibration.parts, 20U);
  for (int i = 0; i < 5; ++i) {
    const double ratio = calibration.jackknife_std(i) / std::sqrt(calibration.covariance(i, i));
    // A standard deviation from 20 parts is known to 16 %; three times that.
    constexpr double kThreeSigmas = 0.5;
    EXPECT_NEAR(ratio, 1, kThreeSigmas);
  }
}

TEST(HandEyeCalibration, GivesTheSameAnswerInARigThatIsTurned) {
  SimulatedHandEye run = swinging(true_hand_eye(), 10, {}, {}, 12);
  const auto upright = calibrate(run);
  // So that the axis swings about -z, where perpendicular_basis turns fast.
  const auto turn = Eigen::Quaterniond::FromTwoVectors(run.fixes[run.fixes.size() / 2].axis,
                                                       -Eigen::Vector3d::UnitZ());
  for (MagneticFix& fix : run.fixes) {
    fix.position = turn * fix.position;
    fix.axis =
        turn * fix.axis;  // equally uncertain about all vectors across: no covariance to turn
  }
  const auto turned = calibrate(run);
  constexpr double kAlike = 0.1;  // of a sigma: the noise is measured in steps of 14 %
  for (int i = 0; i < 5; ++i) {
    const double sigma = std::sqrt(upright.covariance(i, i));
    EXPECT_NEAR(hand_eye_error(turned.estimate, upright.estimate)(i), 0, kAlike * sigma);
    EXPECT_NEAR(std::sqrt(turned.covariance(i, i)), sigma, kAlike * sigma);
  }
}

TEST(HandEyeCalibration, GivesTheSameAnswerFromWhateverStart) {
  const SimulatedHandEye run = stop_and_go(true_hand_eye(), random_poses(40, 11), {}, 11);
  const auto from_wrong = calibrate(run);
  const auto from_truth = calibrate_hand_eye(VisualTrack(run.frames, kMostGap), run.fixes,
                                             true_hand_eye(), [](double) {});
  constexpr double kAlike = 0.02;  // of a sigma
  for (int i = 0; i < 5; ++i) {
    EXPECT_NEAR(hand_eye_error(from_wrong.estimate, from_truth.estimate)(i), 0,
                kAlike * std::sqrt(from_truth.covariance(i, i)));
  }
}

}  // namespace
}  // namespace gastronaut

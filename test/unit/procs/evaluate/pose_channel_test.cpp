#include "evaluate/pose_channel.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <numbers>

#include "evaluate/consistency.hpp"
#include "random_numbers.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr double kRounding = 1e-12;
constexpr std::int64_t kPeriod = 50000;  // microseconds
const SE3 kCameraTMagnet{so3_exp({0.4, -0.2, 0.1}), {0.001, -0.002, -0.011}};

// A curve of some centimetres with slow turns.
SE3 true_pose(std::int64_t utime) {
  const double t = static_cast<double>(utime) * 1e-6;
  return {so3_exp({0.3 * std::sin(t), 0.2 * t, 0.5 * std::cos(t)}),
          {0.03 * std::cos(t), 0.02 * std::sin(2 * t), 0.005 * t}};
}

TruthTrack truth_track(int count) {
  TruthTrack track;
  for (int i = 0; i < count; ++i) track.add(i * kPeriod, true_pose(i * kPeriod));
  return track;
}

// Covariance with correlations: sizes of a millimetre and of half a degree. Well conditioned, or
// terms of second order in the rotation would count.
Matrix6d drawn_covariance(Draws& draws, int size) {
  Eigen::MatrixXd root(size, size);
  for (double& entry : root.reshaped()) entry = draws.normal();
  Matrix6d covariance = Matrix6d::Identity();
  covariance.topLeftCorner(size, size) += root * root.transpose() / size;
  Vector6d scale;
  scale << 1e-3, 1e-3, 1e-3, 0.01, 0.01, 0.01;
  return scale.asDiagonal() * covariance * scale.asDiagonal();
}

Eigen::VectorXd drawn_error(Draws& draws, const Matrix6d& covariance, int size) {
  Eigen::VectorXd unit(size);
  for (double& entry : unit) entry = draws.normal();
  return covariance.topLeftCorner(size, size).llt().matrixL() * unit;
}

void expect_consistent(const PoseEvaluation& evaluation, int size) {
  std::vector<double> values;
  for (const FixErrors& errors : evaluation.fixes) {
    ASSERT_TRUE(errors.normalised_squared);
    values.push_back(*errors.normalised_squared);
  }
  const Consistency result = consistency(values, size);
  EXPECT_GT(result.mean, result.band_low);
  EXPECT_LT(result.mean, result.band_high);
}

constexpr int kFixes = 2000;

TEST(PoseChannelTest, MagneticErrorsDrawnFromTheirCovarianceAreConsistent) {
  PoseChannel channel{"MAGNETIC_POSE", PoseKind::kMagnet, 5, {{"OK", true}}, {}, {}};
  Draws draws(31);
  for (int i = 0; i < kFixes; ++i) {
    const SE3 truth = true_pose(i * kPeriod) * kCameraTMagnet;
    const Eigen::Vector3d axis = truth.rotation * Eigen::Vector3d::UnitZ();
    PoseFix fix{i * kPeriod, 0, truth, drawn_covariance(draws, 5)};
    const Eigen::VectorXd error = drawn_error(draws, fix.covariance, 5);
    fix.pose.translation += error.head<3>();
    const Eigen::Vector3d noisy_axis = so3_exp(perpendicular_basis(axis) * error.tail<2>()) * axis;
    // Any roll will do: the magnet cannot tell it.
    fix.pose.rotation = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), noisy_axis);
    channel.fixes.push_back(fix);
  }
  const PoseEvaluation evaluation =
      evaluate_pose_channel(channel, truth_track(kFixes), kCameraTMagnet);
  expect_consistent(evaluation, 5);
  EXPECT_EQ(evaluation.usable.count_matched(), static_cast<std::size_t>(kFixes));
}

TEST(PoseChannelTest, FusedErrorsDrawnFromTheirCovarianceAreConsistent) {
  PoseChannel channel{"CAPSULE_STATE", PoseKind::kCameraInRig, 6, {{"OK", true}}, {}, {}};
  Draws draws(32);
  for (int i = 0; i < kFixes; ++i) {
    const SE3 truth = true_pose(i * kPeriod);
    PoseFix fix{i * kPeriod, 0, truth, drawn_covariance(draws, 6)};
    const Eigen::VectorXd error = drawn_error(draws, fix.covariance, 6);
    fix.pose = {truth.rotation * so3_exp(error.tail<3>()), truth.translation + error.head<3>()};
    channel.fixes.push_back(fix);
  }
  expect_consistent(evaluate_pose_channel(channel, truth_track(kFixes), SE3{}), 6);
}

TEST(PoseChannelTest, VisualPosesAreComparedAfterAlignmentOfTheirMap) {
  PoseChannel channel{"VISUAL_POSE", PoseKind::kCameraInMap, 6, {{"OK", true}}, {}, {}};
  Draws draws(33);
  const SE3 map_T_rig{draws.rotation(), draws.vector(1)};
  for (int i = 0; i < kFixes; ++i) {
    const SE3 truth = true_pose(i * kPeriod);
    PoseFix fix{i * kPeriod, 0, truth, drawn_covariance(draws, 6)};
    const Eigen::VectorXd error = drawn_error(draws, fix.covariance, 6);
    fix.pose = map_T_rig * SE3{truth.rotation * so3_exp(error.tail<3>()),
                               truth * Eigen::Vector3d(error.head<3>())};
    channel.fixes.push_back(fix);
  }
  expect_consistent(evaluate_pose_channel(channel, truth_track(kFixes), SE3{}), 6);
}

TEST(PoseChannelTest, EachFrameOfTheMapIsAlignedByItself) {
  constexpr int kCount = 300;
  constexpr int kMoved = 100;  // fixes before the map gets another frame
  PoseChannel channel{"VISUAL_POSE", PoseKind::kCameraInMap, 6, {{"OK", true}}, {}, {}};
  Draws draws(34);
  const SE3 first_T_rig{draws.rotation(), draws.vector(1)};
  const SE3 second_T_rig{draws.rotation(), draws.vector(1)};
  for (int i = 0; i < kCount; ++i) {
    const SE3 truth = true_pose(i * kPeriod);
    channel.fixes.push_back({i * kPeriod, 0, (i < kMoved ? first_T_rig : second_T_rig) * truth,
                             Matrix6d::Identity(), i < kMoved ? 0 : 1});
  }
  EXPECT_EQ(channel.main_frame(), 1);
  const PoseEvaluation evaluation = evaluate_pose_channel(channel, truth_track(kCount), SE3{});
  EXPECT_EQ(evaluation.frames, 2U);
  for (const FixErrors& errors : evaluation.fixes) {
    EXPECT_NEAR(errors.position.norm(), 0, kRounding);
    EXPECT_NEAR(errors.rotation, 0, 1e-7);  // of a unit quaternion's rounding the square root
  }
  // What trajectories are made of is all in the frame of most fixes.
  const Pose expected = to_pose(second_T_rig * true_pose(0));
  EXPECT_NEAR((evaluation.usable.estimate.poses[0].translation - expected.translation).norm(), 0,
              kRounding);
  EXPECT_NEAR((evaluation.usable.estimate.poses[0].rotation - expected.rotation).norm(), 0,
              kRounding);
}

TEST(PoseChannelTest, RelativeErrorsPairPosesOfOneMapFrameOnly) {
  constexpr int kCount = 60;
  constexpr int kMoved = 20;  // fixes before the map gets another frame, and then the first again
  PoseChannel channel{"VISUAL_POSE", PoseKind::kCameraInMap, 6, {{"OK", true}}, {}, {}};
  Draws draws(35);
  const SE3 first_T_rig{draws.rotation(), draws.vector(1)};
  const SE3 second_T_rig{draws.rotation(), draws.vector(1)};
  for (int i = 0; i < kCount; ++i) {
    const bool second = i >= kMoved && i < 2 * kMoved;
    channel.fixes.push_back({i * kPeriod, 0,
                             (second ? second_T_rig : first_T_rig) * true_pose(i * kPeriod),
                             Matrix6d::Identity(), second ? 1 : 0});
  }
  // Two bad poses at the end of the second frame: it is placed askew by them.
  for (const int bad : {2 * kMoved - 2, 2 * kMoved - 1}) {
    channel.fixes[static_cast<std::size_t>(bad)].pose.translation += Eigen::Vector3d(0.5, 0, 0);
  }
  const PoseEvaluation evaluation = evaluate_pose_channel(channel, truth_track(kCount), SE3{});
  EXPECT_EQ(parts_within_frames(evaluation).size(), 3U);
  Metrics metrics;
  set_pose_metrics(metrics, channel, evaluation);
  std::map<std::string, Metrics::Value> by_key(metrics.list().begin(), metrics.list().end());
  EXPECT_EQ(std::get<std::int64_t>(by_key.at("VISUAL_POSE.rpe.1frames.count")),
            kCount - 3);  // 19 pairs in each part
  // Rotations are right throughout; none of the pairs bridges two frames.
  EXPECT_LT(std::get<double>(by_key.at("VISUAL_POSE.rpe.1frames.rot_deg.max")), 1e-5);
  EXPECT_LT(std::get<double>(by_key.at("VISUAL_POSE.rpe.1frames.trans.median")), kRounding);
}

TEST(PoseChannelTest, ATiltedMagnetShowsItsAngleWhateverItsRoll) {
  constexpr double kTilt = 0.02;  // radians
  PoseChannel channel{"MAGNETIC_POSE", PoseKind::kMagnet, 5, {{"OK", true}}, {}, {}};
  const SE3 truth = true_pose(kPeriod) * kCameraTMagnet;
  channel.fixes.push_back(
      {kPeriod,
       0,
       {truth.rotation * so3_exp({0, kTilt, 0}) * so3_exp({0, 0, 1.3}), truth.translation},
       Matrix6d::Identity()});
  const PoseEvaluation evaluation = evaluate_pose_channel(channel, truth_track(3), kCameraTMagnet);
  EXPECT_NEAR(evaluation.fixes[0].rotation, kTilt, kRounding);
  EXPECT_NEAR(evaluation.fixes[0].position.norm(), 0, kRounding);
  // For relative errors the roll is the truth's: only the tilt is left.
  const Eigen::Matrix3d difference = evaluation.usable.truth[0]->rotation.transpose() *
                                     evaluation.usable.estimate.poses[0].rotation;
  EXPECT_NEAR(rotation_angle(difference), kTilt, kRounding);
}

TEST(PoseChannelTest, OnlyUsableFiniteFixesCount) {
  PoseChannel channel{
      "CAPSULE_STATE", PoseKind::kCameraInRig, 6, {{"BAD", false}, {"OK", true}}, {}, {}};
  const Matrix6d covariance = Matrix6d::Identity();
  channel.fixes.push_back({0, 1, true_pose(0), covariance});
  channel.fixes.push_back({kPeriod, 0, true_pose(kPeriod), covariance});
  SE3 broken = true_pose(2 * kPeriod);
  broken.translation.x() = std::nan("");
  channel.fixes.push_back({2 * kPeriod, 1, broken, covariance});
  channel.fixes.push_back({3 * kPeriod, 7, true_pose(3 * kPeriod), covariance});  // no such status
  channel.fixes.push_back({4 * kPeriod, -1, true_pose(4 * kPeriod), covariance});
  channel.fixes.push_back({1000 * kPeriod, 1, true_pose(0), covariance});  // beyond the truth
  const PoseEvaluation evaluation = evaluate_pose_channel(channel, truth_track(20), SE3{});
  EXPECT_EQ(evaluation.usable.estimate.utimes, (std::vector<std::int64_t>{0, 1000 * kPeriod}));
  EXPECT_EQ(evaluation.usable.count_matched(), 1U);
  EXPECT_TRUE(evaluation.fixes[1].truth);  // its error is known all the same
}

TEST(AvailabilityTest, IsTheShareOfTheTruthsSpanNearAFix) {
  constexpr double kExact = 1e-9;
  // Fixes every 10, each good for 7.5 around it.
  EXPECT_NEAR(availability({0, 10, 20, 30, 40}, 10, 0, 40), 1, kExact);
  // A hole from 10 to 30 of which 7.5 on either side is covered.
  EXPECT_NEAR(availability({0, 1000, 3000, 4000}, 1000, 0, 4000), 1 - 500.0 / 4000, kExact);
  EXPECT_NEAR(availability({}, 1000, 0, 4000), 0, kExact);
  // What lies outside the truth's span does not help.
  EXPECT_NEAR(availability({-5000, 9000}, 1000, 0, 4000), 0, kExact);
  EXPECT_NEAR(availability({0}, 1000, 0, 0), 0, kExact);
}

TEST(PoseMetricsTest, NothingUsableLeavesCountsAndNoErrors) {
  PoseChannel channel{"CAPSULE_STATE", PoseKind::kCameraInRig, 6, {{"BAD", false}}, {}, {}};
  channel.fixes.push_back({0, 0, true_pose(0), Matrix6d::Identity()});
  Metrics metrics;
  set_pose_metrics(metrics, channel, evaluate_pose_channel(channel, truth_track(20), SE3{}));
  bool counted = false;
  for (const auto& [key, value] : metrics.list()) {
    EXPECT_FALSE(key.ends_with("ate.none.rmse"));
    if (key == "CAPSULE_STATE.status.BAD.count") counted = std::get<std::int64_t>(value) == 1;
  }
  EXPECT_TRUE(counted);
}

}  // namespace
}  // namespace gastronaut::evaluation

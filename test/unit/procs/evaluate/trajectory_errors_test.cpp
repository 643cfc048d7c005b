#include "evaluate/trajectory_errors.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>
#include <numbers>

#include "random_numbers.hpp"

namespace gastronaut::evaluation {
namespace {

using Pairs = std::vector<std::pair<std::size_t, std::size_t>>;

constexpr double kRounding = 1e-12;  // sums of some tens of numbers of size one

MatchedTrajectory matched_positions(const std::vector<Eigen::Vector3d>& estimate,
                                    const std::vector<Eigen::Vector3d>& truth) {
  MatchedTrajectory matched;
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    matched.estimate.utimes.push_back(static_cast<std::int64_t>(i) * 100000);
    matched.estimate.poses.push_back({Eigen::Matrix3d::Identity(), estimate[i]});
    matched.truth.push_back(Pose{Eigen::Matrix3d::Identity(), truth[i]});
  }
  return matched;
}

// Truth drawn, the estimate being what `truth_T_estimate` and the scale make of it backwards.
MatchedTrajectory moved_copy(const SE3& truth_T_estimate, double scale) {
  Draws draws(7);
  std::vector<Eigen::Vector3d> truth;
  std::vector<Eigen::Vector3d> estimate;
  for (int i = 0; i < 30; ++i) {
    truth.push_back(draws.vector(1));
    estimate.push_back(truth_T_estimate.inverse() * truth.back() / scale);
  }
  return matched_positions(estimate, truth);
}

TEST(StatisticsTest, AreThoseOfAHandCalculation) {
  const Statistics result = statistics(std::vector<double>{4, 1, 3, 2});
  EXPECT_EQ(result.count, 4U);
  EXPECT_NEAR(result.mean, 2.5, kRounding);
  EXPECT_NEAR(result.median, 2.5, kRounding);
  EXPECT_NEAR(result.rmse, std::sqrt(7.5), kRounding);
  EXPECT_NEAR(result.std, std::sqrt(1.25), kRounding);
  EXPECT_NEAR(result.sum_of_squares, 30, kRounding);
  EXPECT_EQ(result.min, 1);
  EXPECT_EQ(result.max, 4);
  EXPECT_TRUE(std::isnan(statistics({}).rmse));
}

TEST(AlignTest, RecoversARigidMotion) {
  Draws draws(3);
  const SE3 motion{draws.rotation(), draws.vector(5)};
  const MatchedTrajectory matched = moved_copy(motion, 1);
  const Alignment alignment = align(matched, AlignmentKind::kSe3);
  EXPECT_TRUE(alignment.rotation_determined);
  EXPECT_EQ(alignment.scale, 1);
  EXPECT_LT((alignment.truth_T_estimate.rotation - motion.rotation.toRotationMatrix()).norm(),
            kRounding);
  EXPECT_LT((alignment.truth_T_estimate.translation - motion.translation).norm(), kRounding);
  EXPECT_LT(statistics(absolute_errors(matched, alignment)).max, kRounding);
}

TEST(AlignTest, RecoversASimilarity) {
  Draws draws(4);
  const SE3 motion{draws.rotation(), draws.vector(5)};
  constexpr double kScale = 0.037;
  const Alignment alignment = align(moved_copy(motion, kScale), AlignmentKind::kSim3);
  EXPECT_NEAR(alignment.scale, kScale, kRounding);
  EXPECT_LT((alignment.truth_T_estimate.translation - motion.translation).norm(), kRounding);
}

TEST(AlignTest, NeverReflectsEvenWhereAMirrorImageWouldFitPerfectly) {
  MatchedTrajectory matched = moved_copy(SE3{}, 1);
  for (Pose& pose : matched.estimate.poses) pose.translation.x() *= -1;
  const Alignment alignment = align(matched, AlignmentKind::kSe3);
  EXPECT_NEAR(alignment.truth_T_estimate.rotation.determinant(), 1, kRounding);
  EXPECT_GT(statistics(absolute_errors(matched, alignment)).rmse, 0.1);  // of points one apart
}

TEST(AlignTest, AStraightPathIsAlignedAndItsFreeRotationNamed) {
  std::vector<Eigen::Vector3d> truth;
  std::vector<Eigen::Vector3d> estimate;
  for (int i = 0; i < 10; ++i) {
    truth.emplace_back(i, 0, 0);
    estimate.emplace_back(1, 2, 3 + i);
  }
  const MatchedTrajectory matched = matched_positions(estimate, truth);
  const Alignment alignment = align(matched, AlignmentKind::kSim3);
  EXPECT_FALSE(alignment.rotation_determined);
  EXPECT_NEAR(alignment.scale, 1, kRounding);
  EXPECT_LT(statistics(absolute_errors(matched, alignment)).max, kRounding);
}

TEST(AlignTest, APathInAPlaneIsDetermined) {
  std::vector<Eigen::Vector3d> truth;
  for (int i = 0; i < 10; ++i) truth.emplace_back(i, i * i, 0);
  const MatchedTrajectory matched = matched_positions(truth, truth);
  const Alignment alignment = align(matched, AlignmentKind::kSe3);
  EXPECT_TRUE(alignment.rotation_determined);
  EXPECT_LT((alignment.truth_T_estimate.rotation - Eigen::Matrix3d::Identity()).norm(), kRounding);
}

TEST(AlignTest, PointsInOnePlaceGiveFiniteErrors) {
  const std::vector<Eigen::Vector3d> place(5, Eigen::Vector3d(1, 2, 3));
  const std::vector<Eigen::Vector3d> other(5, Eigen::Vector3d(4, 2, 3));
  const MatchedTrajectory matched = matched_positions(place, other);
  const Alignment alignment = align(matched, AlignmentKind::kSim3);
  EXPECT_FALSE(alignment.rotation_determined);
  EXPECT_EQ(alignment.scale, 1);
  EXPECT_LT(statistics(absolute_errors(matched, alignment)).max, kRounding);
}

TEST(AlignTest, NothingMatchedIsTheIdentity) {
  EXPECT_EQ(align(MatchedTrajectory{}, AlignmentKind::kSim3).scale, 1);
  EXPECT_TRUE(absolute_errors(MatchedTrajectory{}, Alignment{}).empty());
}

TEST(ParseDeltaTest, KnowsFramesMetresMillimetresSecondsAndDegrees) {
  EXPECT_EQ(parse_delta("5frames").unit, DeltaUnit::kFrames);
  EXPECT_EQ(parse_delta("10m").value, 10);
  EXPECT_EQ(parse_delta("10m").unit, DeltaUnit::kMetres);
  EXPECT_NEAR(parse_delta("5mm").value, 0.005, kRounding);
  EXPECT_EQ(parse_delta("0.5s").unit, DeltaUnit::kSeconds);
  EXPECT_EQ(parse_delta("5deg").unit, DeltaUnit::kDegrees);
  for (const char* wrong : {"", "5", "m", "-1m", "0s", "1.5frames", "5 parsec", "infm"}) {
    EXPECT_THROW(parse_delta(wrong), std::invalid_argument) << wrong;
  }
}

// Steps of 1 m along x; the truth makes steps of 2 m.
MatchedTrajectory straight(int count) {
  std::vector<Eigen::Vector3d> truth;
  std::vector<Eigen::Vector3d> estimate;
  for (int i = 0; i < count; ++i) {
    truth.emplace_back(2 * i, 0, 0);
    estimate.emplace_back(i, 0, 0);
  }
  return matched_positions(estimate, truth);
}

TEST(SelectPairsTest, ByFramesStartsWhereTheLastPairEnded) {
  EXPECT_EQ(select_pairs(straight(6), {{2, DeltaUnit::kFrames}}), (Pairs{{0, 2}, {2, 4}}));
  EXPECT_EQ(select_pairs(straight(6), {{4, DeltaUnit::kFrames}, true}), (Pairs{{0, 4}, {1, 5}}));
}

TEST(SelectPairsTest, ByLengthFollowsTheEstimateOrTheTruth) {
  EXPECT_EQ(select_pairs(straight(8), {{2, DeltaUnit::kMetres}}), (Pairs{{2, 4}, {4, 6}}));
  EXPECT_EQ(select_pairs(straight(5), {{4, DeltaUnit::kMetres}, true, true}),
            (Pairs{{0, 2}, {1, 3}, {2, 4}}));
}

TEST(SelectPairsTest, PairsFarFromTheDeltaAreLeftOut) {
  EXPECT_TRUE(select_pairs(straight(5), {{1.5, DeltaUnit::kMetres}, true}).empty());
}

TEST(SelectPairsTest, BySecondsGoesBackFromTheLaterPoseAndStopsBeforeTheEnd) {
  // Poses are 0.1 s apart; the pair that ends at the last pose is not taken (TUM's rule).
  EXPECT_EQ(select_pairs(straight(5), {{0.2, DeltaUnit::kSeconds}}), (Pairs{{2, 0}, {3, 1}}));
}

TEST(SelectPairsTest, ByDegreesAccumulatesTheTurns) {
  MatchedTrajectory turning = straight(7);
  for (std::size_t i = 0; i < turning.estimate.size(); ++i) {
    turning.estimate.poses[i].rotation =
        Eigen::AngleAxisd(static_cast<double>(i) * 2 * std::numbers::pi / 180,
                          Eigen::Vector3d::UnitY())
            .toRotationMatrix();
  }
  EXPECT_EQ(select_pairs(turning, {{5, DeltaUnit::kDegrees}}), (Pairs{{0, 3}, {3, 6}}));
}

TEST(RelativeErrorsTest, AreFreeOfTheFramesAndSeeTheDrift) {
  // Both turn the same way; the estimate lives in another frame and goes 1 % too far.
  Draws draws(11);
  const Pose other_frame = to_pose({draws.rotation(), draws.vector(3)});
  const Pose step{Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ()).toRotationMatrix(), {1, 0, 0}};
  const Pose long_step{step.rotation, {1.01, 0, 0}};
  MatchedTrajectory matched;
  Pose truth;
  Pose estimate = other_frame;
  for (int i = 0; i < 5; ++i) {
    matched.estimate.utimes.push_back(i);
    matched.estimate.poses.push_back(estimate);
    matched.truth.push_back(truth);
    truth = truth * step;
    estimate = estimate * long_step;
  }
  const RelativeErrors errors =
      relative_errors(matched, select_pairs(matched, {{1, DeltaUnit::kFrames}}));
  ASSERT_EQ(errors.translation.size(), 4U);
  for (std::size_t i = 0; i < 4; ++i) {
    EXPECT_NEAR(errors.translation[i], 0.01, kRounding);
    EXPECT_NEAR(errors.rotation[i], 0, kRounding);
  }
  matched.truth[2].reset();
  const Pairs pairs{{0, 1}, {1, 2}, {2, 3}, {3, 4}};
  EXPECT_EQ(relative_errors(matched, pairs).translation.size(), 2U);
}

}  // namespace
}  // namespace gastronaut::evaluation

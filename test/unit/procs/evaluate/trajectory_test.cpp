#include "evaluate/trajectory.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace gastronaut::evaluation {
namespace {

constexpr double kRounding = 1e-12;  // a few operations on numbers of size one

Trajectory at_times(std::vector<std::int64_t> utimes) {
  Trajectory trajectory;
  trajectory.utimes = std::move(utimes);
  for (const std::int64_t utime : trajectory.utimes) {
    trajectory.poses.push_back({Eigen::Matrix3d::Identity(), {static_cast<double>(utime), 0, 0}});
  }
  return trajectory;
}

TEST(MatchTest, NearestPairsWinAndEachPoseIsUsedOnce) {
  // 104 is nearer to 105 than 100 is; 100 must then do without, although 105 is within reach.
  const MatchedTrajectory matched = match(at_times({100, 104, 200}), at_times({105, 195}), 10);
  ASSERT_EQ(matched.truth.size(), 3U);
  EXPECT_FALSE(matched.truth[0]);
  ASSERT_TRUE(matched.truth[1]);
  EXPECT_EQ(matched.truth[1]->translation.x(), 105);
  ASSERT_TRUE(matched.truth[2]);
  EXPECT_EQ(matched.truth[2]->translation.x(), 195);
  EXPECT_EQ(matched.count_matched(), 2U);
  EXPECT_EQ(matched.only_matched().estimate.utimes, (std::vector<std::int64_t>{104, 200}));
}

TEST(MatchTest, PosesExactlyTheMaximumApartDoNotBelongTogether) {
  EXPECT_EQ(match(at_times({100}), at_times({110}), 10).count_matched(), 0U);
  EXPECT_EQ(match(at_times({100}), at_times({90}), 10).count_matched(), 0U);
  EXPECT_EQ(match(at_times({100}), at_times({109}), 10).count_matched(), 1U);
}

TEST(MatchTest, TrajectoriesWithoutTimesMustHaveTheSameLength) {
  EXPECT_EQ(match_by_index(at_times({0, 1}), at_times({0, 1})).count_matched(), 2U);
  EXPECT_THROW(match_by_index(at_times({0, 1}), at_times({0})), std::invalid_argument);
}

TEST(RotationAngleTest, IsExactForSmallAndForHalfTurns) {
  for (const double angle : {0.0, 1e-9, 0.3, 3.0, std::numbers::pi}) {
    const Eigen::Matrix3d rotation =
        Eigen::AngleAxisd(angle, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
    EXPECT_NEAR(rotation_angle(rotation), angle, kRounding);
  }
}

TEST(TruthTrackTest, MovesAlongAScrewBetweenSamples) {
  // A quarter turn about z while going once along the arc of radius one.
  const SE3 start{Eigen::Quaterniond::Identity(), {1, 0, 0}};
  const SE3 end{
      Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitZ())),
      {0, 1, 0}};
  TruthTrack track;
  track.add(0, start);
  track.add(100000, end);
  const auto middle = track.at(50000);
  ASSERT_TRUE(middle);
  const double half = std::sqrt(0.5);
  EXPECT_NEAR((middle->translation - Eigen::Vector3d(half, half, 0)).norm(), 0, kRounding);
  EXPECT_NEAR(angle_between(start.rotation, middle->rotation), std::numbers::pi / 4, kRounding);
}

TEST(TruthTrackTest, SaysNothingOutsideItsSpanOrInLongGaps) {
  TruthTrack track;
  EXPECT_FALSE(track.at(0));
  track.add(1000, SE3{});
  track.add(1000 + TruthTrack::kMaxGap, SE3{});
  track.add(2001 + 2 * TruthTrack::kMaxGap, SE3{});
  track.add(5, SE3{});  // out of order
  EXPECT_EQ(track.size(), 3U);
  EXPECT_FALSE(track.at(999));
  EXPECT_TRUE(track.at(1000));
  EXPECT_TRUE(track.at(1500));
  EXPECT_FALSE(track.at(1001 + TruthTrack::kMaxGap));
  EXPECT_TRUE(track.at(2001 + 2 * TruthTrack::kMaxGap));
  EXPECT_FALSE(track.at(2002 + 2 * TruthTrack::kMaxGap));
}

}  // namespace
}  // namespace gastronaut::evaluation

#include "import/pose_table.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <numbers>

#include "import_fixtures.hpp"

namespace gastronaut {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr double kRounding = 1e-9;
// A quarter turn about z takes x to y; the three formats spell the same pose.
const SE3 kQuarterTurn{so3_exp({0, 0, std::numbers::pi / 2}), {1, 2, 3}};

void expect_quarter_turn(const SE3& pose) {
  EXPECT_LT((pose.inverse() * kQuarterTurn).log().norm(), kRounding);
}

TEST(PoseTable, ReadsTum) {
  CollectedIssues collected;
  const PoseTable table =
      parse_pose_table("# time tx ty tz qx qy qz qw\n0.5 1 2 3 0 0 0.70710678118 0.70710678118\n",
                       "gt.txt", collected.issues);
  ASSERT_EQ(table.poses.size(), 1U);
  EXPECT_FALSE(table.by_frame);
  EXPECT_EQ(table.poses[0].time, 0.5);
  expect_quarter_turn(table.poses[0].world_T_camera);
}

TEST(PoseTable, ReadsKittiByFrameAndABadRowMovesNoOther) {
  CollectedIssues collected;
  const PoseTable table = parse_pose_table(
      "1 0 0 0 0 1 0 0 0 0 1 0\n1 0\n0 -1 0 1 1 0 0 2 0 0 1 3\n", "00.txt", collected.issues);
  ASSERT_EQ(table.poses.size(), 2U);
  EXPECT_TRUE(table.by_frame);
  EXPECT_EQ(table.poses[1].time, 2);
  expect_quarter_turn(table.poses[1].world_T_camera);
  EXPECT_THAT(collected.list, ElementsAre(HasSubstr("00.txt:2: 2 numbers instead of 12")));
}

TEST(PoseTable, ReadsOpen3dBlocksAndSkipsABrokenOne) {
  CollectedIssues collected;
  const PoseTable table = parse_pose_table(
      "0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
      "1 1 2\n1 0 0 0\n0 1 x 0\n0 0 1 0\n0 0 0 1\n"
      "2 2 3\n0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n",
      "peer.log", collected.issues);
  ASSERT_EQ(table.poses.size(), 2U);
  EXPECT_TRUE(table.by_frame);
  EXPECT_EQ(table.poses[1].time, 2);
  expect_quarter_turn(table.poses[1].world_T_camera);
  EXPECT_THAT(collected.list, ElementsAre(HasSubstr("peer.log:6: ")));
}

TEST(PoseTable, WhatIsNoRotationIsLeftOut) {
  CollectedIssues collected;
  const PoseTable tum =
      parse_pose_table("0 1 2 3 0 0 0 0\n1 1 2 3 0 0 0 1\n", "gt.txt", collected.issues);
  EXPECT_EQ(tum.poses.size(), 1U);
  const PoseTable mirrored =
      parse_pose_table("1 0 0 0 0 1 0 0 0 0 -1 0\n", "00.txt", collected.issues);
  EXPECT_EQ(mirrored.poses.size(), 0U);
  EXPECT_THAT(collected.list, ElementsAre(HasSubstr("gt.txt:1: "), HasSubstr("00.txt:1: ")));
}

}  // namespace
}  // namespace gastronaut

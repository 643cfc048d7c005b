#include "visual_slam/wall_motion.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>

#include "unit/procs/visual_slam/slam_scene.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kRelativeStd = 0.03;  // of shading
constexpr double kMotion = 0.2;        // of depth: well beyond what such a depth can be wrong

// What the map has: the wall as it is.
ModelView view_of_wall() {
  const Frame truth = look({}, kStart, 0);
  ModelView view;
  view.grid = truth.grid;
  view.depth = truth.depth;
  view.albedo = truth.albedo;
  view.normal_x = Plane<float>(truth.grid.width, truth.grid.height, 0);
  view.normal_y = Plane<float>(truth.grid.width, truth.grid.height, 0);
  view.normal_z = Plane<float>(truth.grid.width, truth.grid.height, -1);
  return view;
}

// The wall nearer by a fraction of its distance, left of a column.
void move_wall(Frame& frame, int columns, double motion) {
  for (int v = 0; v < frame.grid.height; ++v) {
    for (int u = 0; u < columns; ++u) frame.depth.at(u, v) *= static_cast<float>(1 - motion);
  }
}

TEST(WallMotion, RigidWallHasNoneWhateverTheErrorsOfItsDepth) {
  constexpr std::uint64_t kSeeds = 20;
  for (std::uint64_t seed = 0; seed < kSeeds; ++seed) {
    const Frame keyframe = look({}, kStart, kRelativeStd, 0, seed);
    EXPECT_TRUE(find_wall_motion(keyframe, view_of_wall(), {}).empty()) << "seed " << seed;
  }
}

TEST(WallMotion, WhatHasMovedGoesToWhereItIsSeenAndTheRestStays) {
  Frame keyframe = look({}, kStart, 0);
  keyframe.relative_std = kRelativeStd;
  const int half = keyframe.grid.width / 2;
  move_wall(keyframe, half, kMotion);
  const std::vector<WallPatch> wall = find_wall_motion(keyframe, view_of_wall(), {});
  ASSERT_FALSE(wall.empty());
  for (const WallPatch& patch : wall) {
    const int u = static_cast<int>(patch.pixel) % keyframe.grid.width;
    const double expected = u < half ? 1 - kMotion : 1;
    // A patch is 10 pixels wide, and the wall's relief within it is a fraction of that.
    constexpr double kRelief = 0.01;
    EXPECT_NEAR(patch.seen.norm() / patch.in_map.norm(), expected, kRelief) << "column " << u;
    EXPECT_NEAR(patch.seen.normalized().dot(patch.in_map.normalized()), 1, 1e-12);
    EXPECT_EQ(patch.normal, -Eigen::Vector3d::UnitZ());
  }
}

TEST(WallMotion, SinglePatchesAndOtherSurfacesAreNoWallThatMoves) {
  Frame few = look({}, kStart, 0);
  few.relative_std = kRelativeStd;
  constexpr int kOnePatch = 10;  // columns and rows
  for (int v = 0; v < kOnePatch; ++v) {
    for (int u = 0; u < kOnePatch; ++u) few.depth.at(u, v) *= static_cast<float>(1 - kMotion);
  }
  EXPECT_TRUE(find_wall_motion(few, view_of_wall(), {}).empty());

  Frame other = look({}, kStart, 0);
  other.relative_std = kRelativeStd;
  const WallMotionOptions options;
  move_wall(other, other.grid.width / 2, 1 - std::exp(-1.1 * options.largest));
  EXPECT_TRUE(find_wall_motion(other, view_of_wall(), options).empty());
}

TEST(WallMotion, NothingIsKnownWhereNothingIsSeen) {
  Frame keyframe = look({}, kStart, 0);
  for (float& depth : keyframe.depth.values) depth = 0;
  EXPECT_TRUE(find_wall_motion(keyframe, view_of_wall(), {}).empty());
}

}  // namespace
}  // namespace gastronaut::slam

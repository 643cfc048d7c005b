#include "occupancy_mapper/voxel_walk.hpp"

#include <gtest/gtest.h>

#include <vector>

#include "numerics/counter_random.hpp"

namespace gastronaut::occupancy {
namespace {

constexpr int kLines = 2000;
constexpr double kRange = 40;       // voxels
constexpr double kRounding = 1e-9;  // of voxels, in doubles

Eigen::Vector3d point(const CounterRandom& random, std::uint64_t number) {
  return {kRange * random.uniform(3 * number), kRange * random.uniform(3 * number + 1),
          kRange * random.uniform(3 * number + 2)};
}

std::vector<Eigen::Vector3i> walk(const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
  std::vector<Eigen::Vector3i> voxels;
  walk_voxels(from, to, [&voxels](const Eigen::Vector3i& voxel) { voxels.push_back(voxel); });
  return voxels;
}

// Whether the line comes into the cube, made larger by the rounding (slab test).
bool passes(const Eigen::Vector3d& from, const Eigen::Vector3d& to, const Eigen::Vector3i& voxel) {
  double enter = 0;
  double leave = 1;
  for (int axis = 0; axis < 3; ++axis) {
    const double direction = to[axis] - from[axis];
    const double a = (voxel[axis] - kRounding - from[axis]) / direction;
    const double b = (voxel[axis] + 1 + kRounding - from[axis]) / direction;
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  return enter <= leave;
}

TEST(VoxelWalkTest, VisitsWhatTheLinePassesStepByStep) {
  const CounterRandom random(1, 0);
  for (int line = 0; line < kLines; ++line) {
    const auto number = static_cast<std::uint64_t>(2 * line);
    const Eigen::Vector3d from = point(random, number);
    const Eigen::Vector3d to = point(random, number + 1);
    const auto voxels = walk(from, to);
    const Eigen::Vector3i first = from.cast<int>();
    const Eigen::Vector3i last = to.cast<int>();
    ASSERT_EQ(voxels.front(), first);
    ASSERT_EQ(voxels.back(), last);
    ASSERT_EQ(static_cast<int>(voxels.size()), (last - first).cwiseAbs().sum() + 1);
    for (std::size_t i = 0; i < voxels.size(); ++i) {
      ASSERT_TRUE(passes(from, to, voxels[i]));
      if (i > 0) {
        ASSERT_EQ((voxels[i] - voxels[i - 1]).cwiseAbs().sum(), 1);
      }
    }
  }
}

TEST(VoxelWalkTest, LinesAlongAnAxisAndThroughCornersEnd) {
  const Eigen::Vector3d middle(7.5, 7.5, 7.5);
  EXPECT_EQ(walk(middle, middle).size(), 1U);
  EXPECT_EQ(walk(middle, {2.5, 7.5, 7.5}).size(), 6U);
  // Through corners, one axis at a time.
  EXPECT_EQ(walk(middle, {10.5, 10.5, 10.5}).size(), 10U);
  EXPECT_EQ(walk(middle, {4.5, 10.5, 4.5}).size(), 10U);
}

}  // namespace
}  // namespace gastronaut::occupancy

#include "visual_slam/surfel_blocks.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <limits>
#include <set>

#include "surfel_scene.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kBlock = 0.01;
constexpr double kFarthest = 0.1;
constexpr std::int64_t kAlways = std::numeric_limits<std::int64_t>::min();

Eigen::Vector3f somewhere(std::uint64_t id) {
  const CounterRandom random(3, 0);
  Eigen::Vector3f position;
  for (std::uint64_t axis = 0; axis < 3; ++axis) {
    position[static_cast<int>(axis)] =
        static_cast<float>(0.3 * (random.uniform(3 * id + axis) - 0.5));
  }
  return position;
}

std::set<std::int32_t> seen(const SurfelBlocks& blocks, const SE3& map_T_camera,
                            std::int64_t since = kAlways) {
  std::set<std::int32_t> ids;
  for (const auto group : blocks.in_view(map_T_camera, kSceneGrid, kFarthest, since)) {
    ids.insert(group.begin(), group.end());
  }
  return ids;
}

TEST(SurfelBlocks, ViewMissesNothingAndLeavesOutMost) {
  constexpr int kCount = 20'000;
  SurfelBlocks blocks(kBlock);
  for (std::int32_t id = 0; id < kCount; ++id) {
    blocks.place(id, somewhere(static_cast<std::uint64_t>(id)), 0.0005F, 0);
  }
  for (int k = 0; k < 10; ++k) {
    const SE3 map_T_camera = pose({0.01 * k, -0.005 * k, 0.003 * k}, {0.5 * k, 0.2, -0.3 * k});
    const std::set<std::int32_t> candidates = seen(blocks, map_T_camera);
    int in_picture = 0;
    for (std::int32_t id = 0; id < kCount; ++id) {
      const Eigen::Vector3d point =
          map_T_camera.inverse() * somewhere(static_cast<std::uint64_t>(id)).cast<double>();
      if (point.z() <= 0 || point.z() > kFarthest) continue;
      const double u = kSceneGrid.fx * point.x() / point.z() + kSceneGrid.cx;
      const double v = kSceneGrid.fy * point.y() / point.z() + kSceneGrid.cy;
      if (u < 0 || u > kSceneGrid.width - 1 || v < 0 || v > kSceneGrid.height - 1) continue;
      ++in_picture;
      ASSERT_TRUE(candidates.count(id)) << id;
    }
    // A view holds a tenth of that space at most; blocks add their own size around it.
    EXPECT_LT(candidates.size(), static_cast<std::size_t>(kCount / 4));
    EXPECT_LE(static_cast<std::size_t>(in_picture), candidates.size());
  }
}

TEST(SurfelBlocks, SurfelsAreFoundWhereTheyMovedAndNotOnceRemoved) {
  SurfelBlocks blocks(kBlock);
  const Eigen::Vector3f ahead(0, 0, 0.05F);
  const Eigen::Vector3f behind(0, 0, -0.05F);
  for (std::int32_t id = 0; id < 3; ++id) blocks.place(id, ahead, 0.001F, 0);
  EXPECT_EQ(seen(blocks, {}), (std::set<std::int32_t>{0, 1, 2}));
  blocks.move(0, behind, 0.001F, 0);
  EXPECT_EQ(seen(blocks, {}), (std::set<std::int32_t>{1, 2}));
  blocks.remove(1);
  EXPECT_EQ(seen(blocks, {}), (std::set<std::int32_t>{2}));
  blocks.move(0, ahead, 0.001F, 0);
  EXPECT_EQ(seen(blocks, {}), (std::set<std::int32_t>{0, 2}));
}

TEST(SurfelBlocks, BlocksOfOldSurfelsAreNoPartOfTheActiveMap) {
  SurfelBlocks blocks(kBlock);
  const Eigen::Vector3f ahead(0, 0, 0.05F);
  blocks.place(0, ahead, 0.001F, 100);
  EXPECT_TRUE(seen(blocks, {}, 101).empty());
  blocks.move(0, ahead, 0.001F, 200);
  EXPECT_EQ(seen(blocks, {}, 101).size(), 1U);
}

TEST(SurfelBlocks, DiscThatReachesIntoViewIsSeen) {
  SurfelBlocks blocks(kBlock);
  blocks.place(0, {0, 0.095F, 0.05F}, 0.0F, 0);
  EXPECT_TRUE(seen(blocks, {}).empty());
  blocks.move(0, {0, 0.095F, 0.05F}, 0.07F, 0);
  EXPECT_EQ(seen(blocks, {}).size(), 1U);
}

TEST(SurfelBlocks, OnlyFinitePlacesNotTooFarAreReached) {
  const SurfelBlocks blocks(kBlock);
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  EXPECT_TRUE(blocks.reaches({-0.1F, 0.2F, 1000}));
  EXPECT_FALSE(blocks.reaches({0, 1e30F, 0}));
  for (const Eigen::Vector3f& position :
       {Eigen::Vector3f(kNaN, 0, 0), Eigen::Vector3f(0, kNaN, 0), Eigen::Vector3f(1, 2, kNaN),
        Eigen::Vector3f(0, 0, std::numeric_limits<float>::infinity())}) {
    EXPECT_FALSE(blocks.reaches(position));
  }
}

}  // namespace
}  // namespace gastronaut::slam

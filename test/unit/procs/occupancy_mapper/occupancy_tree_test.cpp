#include "occupancy_mapper/occupancy_tree.hpp"

#include <gtest/gtest.h>

#include <map>
#include <memory>
#include <sstream>
#include <string>

#include "numerics/counter_random.hpp"

namespace gastronaut::occupancy {
namespace {

constexpr double kLeaf = 1e-3;  // metres
constexpr int kSide = 6;        // blocks: several levels above them, some of them full
const VoxelIndex kOrigin(32768 - 8, 32768, 32768 - 4);

VoxelIndex block_corner(int number) {
  return kOrigin +
         kBlockSide * VoxelIndex(number % kSide, number / kSide % kSide, number / kSide / kSide);
}

// Unknown, free as a whole, full of wall, or anything in between.
BlockState random_state(const CounterRandom& random, std::uint64_t number) {
  const std::uint64_t occupied = random.bits(3 * number);
  const std::uint64_t free = random.bits(3 * number + 1) & ~occupied;
  switch (random.bits(3 * number + 2) % 5) {
    case 0:
      return {};
    case 1:
      return {0, ~std::uint64_t{0}};
    case 2:
      return {~std::uint64_t{0}, 0};
    case 3:
      return {occupied, free};
    default:
      // Cubes of two voxels a side that are of one kind, beside some that are not.
      return {0x0000003300330033U, 0x00CC00CC33000000U};
  }
}

octomap::OcTreeKey key_of(const VoxelIndex& voxel) {
  return {static_cast<octomap::key_type>(voxel.x()), static_cast<octomap::key_type>(voxel.y()),
          static_cast<octomap::key_type>(voxel.z())};
}

TEST(OccupancyTreeTest, HoldsTheBlocksAsTheyAreNowWhateverTheyWere) {
  constexpr int kBlocks = kSide * kSide * kSide;
  constexpr std::uint64_t kChanges = 3000;  // some fifteen a block
  const CounterRandom random(2, 0);
  OccupancyTree tree(kLeaf);
  std::map<int, BlockState> states;
  for (std::uint64_t i = 0; i < kChanges; ++i) {
    const int number = static_cast<int>(random.bits(kChanges * 4 + i) % kBlocks);
    states[number] = random_state(random, i);
    tree.set_block(block_corner(number), states[number]);
  }
  OccupancyTree fresh(kLeaf);
  for (const auto& [number, state] : states) {
    fresh.set_block(block_corner(number), state);
    for (int voxel = 0; voxel < kBlockVoxels; ++voxel) {
      const VoxelIndex index =
          block_corner(number) + VoxelIndex(voxel & 3, voxel >> 2 & 3, voxel >> 4);
      const octomap::OcTreeNode* node = tree.search(key_of(index));
      ASSERT_EQ(node != nullptr, ((state.occupied | state.free) >> voxel & 1) != 0);
      if (node != nullptr) {
        ASSERT_EQ(tree.isNodeOccupied(node), (state.occupied >> voxel & 1) != 0);
      }
    }
  }
  EXPECT_EQ(tree.size(), tree.calcNumNodes());
  EXPECT_EQ(tree.as_ot({}), fresh.as_ot({}));
  // It is as small as octomap itself makes it, and inner nodes are what octomap makes them.
  OccupancyTree pruned = tree;
  pruned.updateInnerOccupancy();
  pruned.prune();
  EXPECT_EQ(tree.as_ot({}), pruned.as_ot({}));
}

TEST(OccupancyTreeTest, IsEmptyAgainWhenNothingIsKnown) {
  OccupancyTree tree(kLeaf);
  for (const bool full : {true, false}) {
    for (int i = 0; i < kSide; ++i) {
      tree.set_block(block_corner(i), full ? BlockState{1, ~std::uint64_t{1}} : BlockState{});
    }
    EXPECT_EQ(tree.size() > 0, full);
    EXPECT_EQ(tree.getRoot() != nullptr, full);
  }
}

TEST(OccupancyTreeTest, OctomapReadsTheFilesAndSkipsTheComments) {
  OccupancyTree tree(kLeaf);
  const CounterRandom random(3, 0);
  for (int i = 0; i < kSide * kSide; ++i) {
    tree.set_block(block_corner(i), random_state(random, static_cast<std::uint64_t>(i)));
  }
  std::istringstream bt(tree.as_bt({{"clearance", "0.01"}, {"data", "is no end of the header"}}));
  octomap::OcTree read(kLeaf * 2);
  ASSERT_TRUE(read.readBinary(bt));
  EXPECT_EQ(read.getResolution(), kLeaf);
  EXPECT_EQ(read.size(), tree.size());
  EXPECT_EQ(read.getNumLeafNodes(), tree.getNumLeafNodes());
  std::istringstream ot(tree.as_ot({{"coverage", "0.5"}}));
  const std::unique_ptr<octomap::AbstractOcTree> any(octomap::AbstractOcTree::read(ot));
  ASSERT_NE(dynamic_cast<octomap::OcTree*>(any.get()), nullptr);
  EXPECT_TRUE(*dynamic_cast<octomap::OcTree*>(any.get()) == static_cast<octomap::OcTree&>(tree));
}

TEST(OccupancyTreeTest, AnEmptyTreeIsAFileToo) {
  std::istringstream bt(OccupancyTree(kLeaf).as_bt({}));
  octomap::OcTree read(kLeaf);
  EXPECT_TRUE(read.readBinary(bt));
  EXPECT_EQ(read.size(), 0U);
}

}  // namespace
}  // namespace gastronaut::occupancy

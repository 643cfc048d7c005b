// Space as it is known, in voxels that are kept in blocks of 4 x 4 x 4: how many surfels lie in
// each voxel, and how many lines of sight pass it.
//
// A line of sight goes from a voxel of the wall to where a camera saw it from, and lasts as long as
// there is wall in that voxel: free space follows the wall when it moves or is found to be wrong.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <unordered_map>
#include <vector>

namespace gastronaut::occupancy {

inline constexpr int kBlockSide = 4;  // voxels
inline constexpr int kBlockVoxels = kBlockSide * kBlockSide * kBlockSide;
inline constexpr int kSpaceSide = 65536;  // voxels, as an octree of 16 levels has

using VoxelIndex = Eigen::Vector3i;  // 0 <= each < kSpaceSide

// Number of a voxel in its block: x fastest, z slowest.
inline int voxel_in_block(const VoxelIndex& voxel) {
  return (voxel.x() & 3) | (voxel.y() & 3) << 2 | (voxel.z() & 3) << 4;
}

struct BlockState {
  std::uint64_t occupied = 0;  // one bit a voxel
  std::uint64_t free = 0;      // the same; a block without wall is free as a whole or not at all

  bool is_unknown() const { return (occupied | free) == 0; }
};

// Of the boundary of the free space that was seen. Counted in faces between blocks: coarser than
// the wall, so that a line of sight that happens to miss a voxel opens no gap.
struct Boundary {
  std::int64_t wall = 0;      // faces between a free block and one with wall in it
  std::int64_t frontier = 0;  // and between a free block and one that was never seen
};

class SpaceBlocks {
 public:
  // One surfel more in that voxel, or one less of those that are in it. True: the voxel was free of
  // surfels before, respectively is now.
  bool add_surfel(const VoxelIndex& voxel);
  bool remove_surfel(const VoxelIndex& voxel);

  // A line of sight from the centre of a voxel to a point in space, in voxels; that voxel itself is
  // not counted. What was added is to be removed with the same arguments.
  void add_sight(const VoxelIndex& voxel, const Eigen::Vector3d& viewpoint);
  void remove_sight(const VoxelIndex& voxel, const Eigen::Vector3d& viewpoint);
  // For whoever adds them: the number of the viewpoint of an occupied voxel's line of sight; 0
  // until it is set, and again once the voxel is free of surfels.
  std::uint16_t& viewpoint_of(const VoxelIndex& voxel);
  // That of some voxel in the same block; 0: none has one.
  std::uint16_t viewpoint_near(const VoxelIndex& voxel) const;

  bool is_occupied(const VoxelIndex& voxel) const;
  bool is_free(const VoxelIndex& voxel) const;

  // From a point (in voxels) to the nearest point of an occupied voxel, in voxels; nothing where
  // none is occupied.
  std::optional<double> distance_to_wall(const Eigen::Vector3d& point) const;
  Boundary boundary() const;

  // visit(voxel, state) for each block that has changed since the last call, with the voxel at its
  // lowest corner; a state of all zeros: nothing is known there any more.
  template <class Visit>
  void take_changes(const Visit& visit) {
    for (const std::uint64_t key : changed_) {
      const auto found = blocks_.find(key);
      found->second.is_changed = false;
      visit(corner(key), state(found->second));
      if (found->second.is_empty()) blocks_.erase(found);
    }
    changed_.clear();
  }

  void clear();
  std::size_t size() const { return blocks_.size(); }

 private:
  struct Block {
    std::uint64_t occupied = 0;
    std::uint32_t sights = 0;  // lines of sight that pass the block
    bool is_changed = false;
    std::array<std::uint32_t, kBlockVoxels> surfels{};
    std::array<std::uint32_t, kBlockVoxels> passes{};  // lines of sight that pass each voxel
    std::array<std::uint16_t, kBlockVoxels> viewpoints{};

    bool is_empty() const { return occupied == 0 && sights == 0; }
  };
  // Keys differ in few bits: these spread them over the table (Fibonacci hashing).
  struct Spread {
    std::size_t operator()(std::uint64_t key) const {
      key *= 0x9E3779B97F4A7C15U;
      return key ^ key >> 32;
    }
  };

  static std::uint64_t key_of(const VoxelIndex& voxel);
  static VoxelIndex corner(std::uint64_t key);
  static BlockState state(const Block& block);
  const Block* find(const VoxelIndex& voxel) const;
  Block& at(std::uint64_t key) { return blocks_[key]; }
  void mark_changed(Block& block, std::uint64_t key);
  void count_sight(const VoxelIndex& voxel, const Eigen::Vector3d& viewpoint, std::uint32_t one);

  std::unordered_map<std::uint64_t, Block, Spread> blocks_;
  std::vector<std::uint64_t> changed_;
};

}  // namespace gastronaut::occupancy

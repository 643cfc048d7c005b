#include "occupancy_mapper/space_blocks.hpp"

#include <algorithm>
#include <bit>
#include <limits>

#include "occupancy_mapper/voxel_walk.hpp"

namespace gastronaut::occupancy {
namespace {

constexpr int kBlockBits = 2;  // of a coordinate within its block
constexpr int kKeyBits = 14;   // of a block's coordinate
constexpr std::uint64_t kKeyMask = (std::uint64_t{1} << kKeyBits) - 1;
constexpr std::uint64_t kAll = ~std::uint64_t{0};

std::uint64_t bit(int voxel) { return std::uint64_t{1} << voxel; }

// From a point to the nearest point of a cube.
double squared_distance(const Eigen::Vector3d& point, const VoxelIndex& lowest, int side) {
  const Eigen::Vector3d low = lowest.cast<double>();
  const Eigen::Vector3d high = low.array() + side;
  return (point - point.cwiseMax(low).cwiseMin(high)).squaredNorm();
}

}  // namespace

std::uint64_t SpaceBlocks::key_of(const VoxelIndex& voxel) {
  const auto part = [&voxel](int axis) {
    return static_cast<std::uint64_t>(voxel[axis] >> kBlockBits) & kKeyMask;
  };
  return part(0) | part(1) << kKeyBits | part(2) << (2 * kKeyBits);
}

VoxelIndex SpaceBlocks::corner(std::uint64_t key) {
  const auto part = [key](int axis) {
    return static_cast<int>(key >> (axis * kKeyBits) & kKeyMask) << kBlockBits;
  };
  return {part(0), part(1), part(2)};
}

BlockState SpaceBlocks::state(const Block& block) {
  if (block.occupied == 0) return {0, block.sights > 0 ? kAll : 0};
  BlockState result{block.occupied, 0};
  for (int i = 0; i < kBlockVoxels; ++i) {
    if (block.passes[static_cast<std::size_t>(i)] > 0) result.free |= bit(i);
  }
  result.free &= ~block.occupied;
  return result;
}

const SpaceBlocks::Block* SpaceBlocks::find(const VoxelIndex& voxel) const {
  const auto found = blocks_.find(key_of(voxel));
  return found == blocks_.end() ? nullptr : &found->second;
}

void SpaceBlocks::mark_changed(Block& block, std::uint64_t key) {
  if (block.is_changed) return;
  block.is_changed = true;
  changed_.push_back(key);
}

bool SpaceBlocks::add_surfel(const VoxelIndex& voxel) {
  const std::uint64_t key = key_of(voxel);
  Block& block = at(key);
  const int number = voxel_in_block(voxel);
  if (block.surfels[static_cast<std::size_t>(number)]++ > 0) return false;
  block.occupied |= bit(number);
  mark_changed(block, key);
  return true;
}

bool SpaceBlocks::remove_surfel(const VoxelIndex& voxel) {
  const std::uint64_t key = key_of(voxel);
  Block& block = at(key);
  const int number = voxel_in_block(voxel);
  if (--block.surfels[static_cast<std::size_t>(number)] > 0) return false;
  block.occupied &= ~bit(number);
  block.viewpoints[static_cast<std::size_t>(number)] = 0;
  mark_changed(block, key);
  return true;
}

std::uint16_t& SpaceBlocks::viewpoint_of(const VoxelIndex& voxel) {
  return at(key_of(voxel)).viewpoints[static_cast<std::size_t>(voxel_in_block(voxel))];
}

std::uint16_t SpaceBlocks::viewpoint_near(const VoxelIndex& voxel) const {
  const Block* block = find(voxel);
  if (block == nullptr) return 0;
  return *std::max_element(block->viewpoints.begin(), block->viewpoints.end());
}

// Numbers are unsigned and wrap: one is 1, or -1 to take away.
void SpaceBlocks::count_sight(const VoxelIndex& voxel, const Eigen::Vector3d& viewpoint,
                              std::uint32_t one) {
  const std::uint32_t first = one == 1 ? 1 : 0;  // a count that tells of a change
  std::uint64_t key = 0;
  Block* block = nullptr;
  bool is_end = true;
  walk_voxels(voxel.cast<double>().array() + 0.5, viewpoint, [&](const VoxelIndex& passed) {
    const std::uint64_t passed_key = key_of(passed);
    if (block == nullptr || passed_key != key) {
      key = passed_key;
      block = &at(key);
      block->sights += one;
      if (block->sights == first) mark_changed(*block, key);
    }
    if (!is_end) {
      std::uint32_t& passes = block->passes[static_cast<std::size_t>(voxel_in_block(passed))];
      passes += one;
      if (passes == first && block->occupied != 0) mark_changed(*block, key);
    }
    is_end = false;
  });
}

void SpaceBlocks::add_sight(const VoxelIndex& voxel, const Eigen::Vector3d& viewpoint) {
  count_sight(voxel, viewpoint, 1);
}

void SpaceBlocks::remove_sight(const VoxelIndex& voxel, const Eigen::Vector3d& viewpoint) {
  count_sight(voxel, viewpoint, static_cast<std::uint32_t>(-1));
}

bool SpaceBlocks::is_occupied(const VoxelIndex& voxel) const {
  const Block* block = find(voxel);
  return block != nullptr && (block->occupied & bit(voxel_in_block(voxel))) != 0;
}

bool SpaceBlocks::is_free(const VoxelIndex& voxel) const {
  const Block* block = find(voxel);
  return block != nullptr && (state(*block).free & bit(voxel_in_block(voxel))) != 0;
}

std::optional<double> SpaceBlocks::distance_to_wall(const Eigen::Vector3d& point) const {
  double nearest = std::numeric_limits<double>::infinity();
  for (const auto& [key, block] : blocks_) {
    if (block.occupied == 0) continue;
    const VoxelIndex lowest = corner(key);
    if (squared_distance(point, lowest, kBlockSide) >= nearest) continue;
    for (std::uint64_t left = block.occupied; left != 0; left &= left - 1) {
      const int number = std::countr_zero(left);
      const VoxelIndex voxel = lowest + VoxelIndex(number & 3, number >> 2 & 3, number >> 4);
      nearest = std::min(nearest, squared_distance(point, voxel, 1));
    }
  }
  if (nearest == std::numeric_limits<double>::infinity()) return std::nullopt;
  return std::sqrt(nearest);
}

Boundary SpaceBlocks::boundary() const {
  Boundary result;
  for (const auto& [key, block] : blocks_) {
    if (block.occupied != 0 || block.sights == 0) continue;
    const VoxelIndex lowest = corner(key);
    for (int axis = 0; axis < 3; ++axis) {
      for (const int step : {-kBlockSide, kBlockSide}) {
        VoxelIndex beside = lowest;
        beside[axis] += step;
        if (beside[axis] < 0 || beside[axis] >= kSpaceSide) continue;
        const Block* neighbour = find(beside);
        if (neighbour == nullptr || neighbour->is_empty()) {
          ++result.frontier;
        } else if (neighbour->occupied != 0) {
          ++result.wall;
        }
      }
    }
  }
  return result;
}

void SpaceBlocks::clear() {
  blocks_.clear();
  changed_.clear();
}

}  // namespace gastronaut::occupancy

#include "visual_slam/surfel_blocks.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace gastronaut::slam {
namespace {

constexpr int kAxisBits = 21;
constexpr double kMostBlocks = 1 << (kAxisBits - 1);  // from the origin, on each axis
constexpr double kRoundingMargin = 1e-3;              // of a block's size

}  // namespace

bool SurfelBlocks::reaches(const Eigen::Vector3f& position) const {
  // A comparison with NaN is false.
  return position.cast<double>().cwiseAbs().maxCoeff<Eigen::PropagateNaN>() <
         (kMostBlocks - 1) * block_size_;
}

std::uint64_t SurfelBlocks::key_of(const Eigen::Vector3f& position) const {
  std::uint64_t key = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double cell = std::floor(static_cast<double>(position[axis]) / block_size_);
    key = key << kAxisBits | static_cast<std::uint64_t>(cell + kMostBlocks);
  }
  return key;
}

std::int32_t SurfelBlocks::block_at(const Eigen::Vector3f& position, std::uint64_t key) {
  const auto [entry, is_new] = by_key_.try_emplace(key, static_cast<std::int32_t>(blocks_.size()));
  if (is_new) {
    SurfelBlock block;
    block.key = key;
    for (int axis = 0; axis < 3; ++axis) {
      block.centre[axis] =
          (std::floor(static_cast<double>(position[axis]) / block_size_) + 0.5) * block_size_;
    }
    blocks_.push_back(std::move(block));
  }
  return entry->second;
}

void SurfelBlocks::place(std::int32_t id, const Eigen::Vector3f& position, float radius,
                         std::int64_t updated) {
  const auto index = static_cast<std::size_t>(id);
  if (index >= places_.size()) places_.resize(index + 1);
  const std::int32_t number = block_at(position, key_of(position));
  SurfelBlock& block = blocks_[static_cast<std::size_t>(number)];
  places_[index] = {number, static_cast<std::int32_t>(block.ids.size())};
  block.ids.push_back(id);
  block.reach = std::max(block.reach, radius);
  block.updated = block.ids.size() == 1 ? updated : std::max(block.updated, updated);
}

void SurfelBlocks::move(std::int32_t id, const Eigen::Vector3f& position, float radius,
                        std::int64_t updated) {
  SurfelBlock& block =
      blocks_[static_cast<std::size_t>(places_[static_cast<std::size_t>(id)].block)];
  if (block.key == key_of(position)) {
    block.reach = std::max(block.reach, radius);
    block.updated = std::max(block.updated, updated);
  } else {
    remove(id);
    place(id, position, radius, updated);
  }
}

void SurfelBlocks::remove(std::int32_t id) {
  Place& place = places_[static_cast<std::size_t>(id)];
  std::vector<std::int32_t>& ids = blocks_[static_cast<std::size_t>(place.block)].ids;
  const std::int32_t last = ids.back();
  ids[static_cast<std::size_t>(place.slot)] = last;
  ids.pop_back();
  places_[static_cast<std::size_t>(last)].slot = place.slot;
  place.block = -1;
}

std::vector<std::span<const std::int32_t>> SurfelBlocks::in_view(const SE3& map_T_camera,
                                                                 const PinholeGrid& grid,
                                                                 double farthest,
                                                                 std::int64_t active_since) const {
  // Normals of the view's sides, camera frame, inwards; each side passes through the camera.
  const double left = (-1 - grid.cx) / grid.fx;
  const double right = (grid.width - grid.cx) / grid.fx;
  const double top = (-1 - grid.cy) / grid.fy;
  const double bottom = (grid.height - grid.cy) / grid.fy;
  std::array<Eigen::Vector3d, 6> sides = {
      {{1, 0, -left}, {-1, 0, right}, {0, 1, -top}, {0, -1, bottom}, {0, 0, 1}, {0, 0, -1}}};
  const std::array<double, 6> offsets = {0, 0, 0, 0, 0, farthest};
  std::array<double, 6> half_width;  // of a cube, along each normal
  const double half = (0.5 + kRoundingMargin) * block_size_;
  const Eigen::Matrix3d rotation = map_T_camera.rotation.toRotationMatrix();
  for (std::size_t k = 0; k < sides.size(); ++k) {
    sides[k] = rotation * sides[k].normalized();
    half_width[k] = half * sides[k].cwiseAbs().sum();
  }

  std::vector<std::span<const std::int32_t>> visible;
  for (const SurfelBlock& block : blocks_) {
    if (block.ids.empty() || block.updated < active_since) continue;
    const Eigen::Vector3d centre = block.centre - map_T_camera.translation;
    bool inside = true;
    for (std::size_t k = 0; k < sides.size() && inside; ++k) {
      inside =
          sides[k].dot(centre) + offsets[k] + half_width[k] + static_cast<double>(block.reach) >= 0;
    }
    if (inside) visible.emplace_back(block.ids);
  }
  return visible;
}

}  // namespace gastronaut::slam

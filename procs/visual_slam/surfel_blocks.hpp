// Which surfels are where: cubes of space with the ids of the surfels inside, so that a view
// touches only what it can see however large the map is.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "camera/pinhole_grid.hpp"
#include "geometry/se3.hpp"

namespace gastronaut::slam {

// A block's surfels lie inside its cube, their discs within `reach` of it.
struct SurfelBlock {
  std::uint64_t key = 0;
  Eigen::Vector3d centre;    // metres, map frame
  float reach = 0;           // metres, the largest radius ever inside
  std::int64_t updated = 0;  // utime, the latest of the surfels ever inside
  std::vector<std::int32_t> ids;
};

// Blocks are kept in the order in which they were first needed, ids in an order that depends on
// the calls alone: whoever walks them does so in the same order in every run.
class SurfelBlocks {
 public:
  // block_size: the cubes' edge in metres.
  explicit SurfelBlocks(double block_size) : block_size_(block_size) {}

  // Whether a position can be addressed: finite and within a million blocks of the origin.
  bool reaches(const Eigen::Vector3f& position) const;

  // Positions must be within reach; ids new (place), respectively present.
  void place(std::int32_t id, const Eigen::Vector3f& position, float radius, std::int64_t updated);
  void move(std::int32_t id, const Eigen::Vector3f& position, float radius, std::int64_t updated);
  void remove(std::int32_t id);

  const std::vector<SurfelBlock>& blocks() const { return blocks_; }

  // The ids of each block that was updated at active_since or later and may cover a pixel of a
  // camera at map_T_camera, no farther than `farthest` metres along its axis; none is missed.
  std::vector<std::span<const std::int32_t>> in_view(const SE3& map_T_camera,
                                                     const PinholeGrid& grid, double farthest,
                                                     std::int64_t active_since) const;

 private:
  struct Place {
    std::int32_t block = -1;
    std::int32_t slot = 0;
  };

  std::uint64_t key_of(const Eigen::Vector3f& position) const;
  std::int32_t block_at(const Eigen::Vector3f& position, std::uint64_t key);

  double block_size_;
  std::vector<SurfelBlock> blocks_;
  std::unordered_map<std::uint64_t, std::int32_t> by_key_;  // looked up, never walked
  std::vector<Place> places_;                               // by id
};

}  // namespace gastronaut::slam

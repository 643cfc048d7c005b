// Blood vessels in an organ's wall: trees that wander over the surface, branch and grow thin, kept
// as segments in a grid so that the vessel at any point of the wall is found at once.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "virtual_rig/organ.hpp"

namespace gastronaut {

// Cubes of equal size over the box around some points.
class CellGrid {
 public:
  CellGrid() = default;
  CellGrid(const Eigen::Vector3f& low, const Eigen::Vector3f& high);

  std::size_t size() const { return static_cast<std::size_t>(cells_.prod()); }
  Eigen::Array3i cell_of(const Eigen::Vector3f& point) const;
  bool contains(const Eigen::Array3i& cell) const {
    return (cell >= 0).all() && (cell < cells_).all();
  }
  std::size_t number(const Eigen::Array3i& cell) const;

 private:
  Eigen::Vector3f low_ = Eigen::Vector3f::Zero();
  Eigen::Array3i cells_ = Eigen::Array3i::Zero();
};

class VesselNetwork {
 public:
  // `density` in metres of vessel per square metre of wall.
  VesselNetwork(const TriangleMesh& wall, double density, std::uint64_t seed);

  // How much vessel is seen at a point of the wall at rest: 0 none, 1 the middle of a thick one.
  float at(const Eigen::Vector3f& point) const;

  struct Segment {
    Eigen::Vector3f start;
    Eigen::Vector3f along;  // to the end
    float start_radius;     // metres
    float end_radius;
    float strength;
  };
  const std::vector<Segment>& segments() const { return segments_; }

 private:
  void fill_grid();

  std::vector<Segment> segments_;
  CellGrid grid_;
  std::vector<std::uint32_t> first_;    // of each cell, and one more
  std::vector<std::uint32_t> members_;  // segment numbers, cell after cell
};

}  // namespace gastronaut

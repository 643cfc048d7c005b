// Finds the nodes of a deformation graph that a point follows.
#pragma once

#include <Eigen/Core>
#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <vector>

#include "visual_slam/deformation_graph.hpp"

namespace gastronaut::slam {

// Space is cut into cells; the nodes around a cell are listed, nearest first, when the first point
// in it is asked for. May be asked by many threads at once.
class NodeSearch {
 public:
  // time_reach: microseconds. Neighbouring cells are `spacing` apart, or more in wide graphs.
  NodeSearch(const std::vector<DeformationNode>& nodes, double spacing, std::int64_t time_reach);
  ~NodeSearch();
  NodeSearch(const NodeSearch&) = delete;
  NodeSearch& operator=(const NodeSearch&) = delete;

  Influences influences(const Eigen::Vector3d& point, const TimeSpan& seen) const;

 private:
  struct Place {
    Eigen::Vector3d position;
    TimeSpan seen;
  };
  struct Listed {
    double distance;  // metres, from the cell's centre
    std::int32_t node;
  };
  using List = std::vector<Listed>;
  struct Nearest;

  const List& list(std::size_t cell, const Eigen::Vector3d& centre) const;

  std::vector<Place> places_;
  std::int64_t time_reach_;
  double spacing_;
  Eigen::Vector3d origin_ = Eigen::Vector3d::Zero();
  double cell_ = 1;  // metres
  std::array<std::size_t, 3> cells_ = {1, 1, 1};
  mutable std::vector<std::atomic<const List*>> lists_;
};

}  // namespace gastronaut::slam

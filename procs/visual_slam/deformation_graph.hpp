// The deformation graph: a few hundred nodes spread evenly over the surface and over the time in
// which it was seen, each with an affine motion; all surfels and poses follow the nodes near them.
// After the paper's section on the deformation graph, Sumner et al., "Embedded deformation for
// shape manipulation", 2007, and Whelan et al., "ElasticFusion", 2015.
//
// A point p goes to sum_n w_n [R_n (p - g_n) + g_n + t_n], its normal along sum_n w_n R_n^-T n,
// over the k nodes nearest to it of those that were seen when it was, with
// w_n = (1 - |p - g_n| / d_max)^2 normalised to sum 1, and d_max the distance of the next node.
//
// Time is what tells two layers of one surface apart: a piece of surface was seen from when it was
// made until it was last updated, and what was seen within `time_reach` of each other belongs
// together. A revisit thus has nodes of its own, tied to those of the first visit through what was
// seen in between, and the two can be moved against each other.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "geometry/se3.hpp"
#include "visual_slam/surfel_arrays.hpp"

namespace gastronaut::slam {

inline constexpr int kDeformationNeighbours = 4;  // the paper's k

struct DeformationGraphOptions {
  double spacing = 0.005;       // metres: nodes seen together are no closer
  double time_reach = 6.7;      // seconds: the map's active window
  int least_surfels = 5;        // in a cell of half a spacing, to make a node
  double least_confidence = 0;  // of the surfels that make nodes; all of them follow
};

// From when to when something was seen, utime.
struct TimeSpan {
  std::int64_t first = 0;
  std::int64_t last = 0;

  static TimeSpan at(std::int64_t utime) { return {utime, utime}; }
  // Microseconds between the two; 0 when they overlap.
  std::int64_t gap(const TimeSpan& other) const {
    return std::max(std::int64_t{0}, std::max(first - other.last, other.first - last));
  }
};

struct DeformationNode {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();     // g, metres, map frame
  TimeSpan seen;                                          // first: the node's timestamp
  Eigen::Matrix3d affine = Eigen::Matrix3d::Identity();   // R
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  // t, metres

  // Where the node takes a point that was near it.
  Eigen::Vector3d operator*(const Eigen::Vector3d& p) const {
    return affine * (p - position) + position + translation;
  }
};

struct Influences {
  int count = 0;  // at most k; fewer only where fewer nodes were seen then, 0 only without nodes
  std::array<std::int32_t, kDeformationNeighbours> node{};
  std::array<double, kDeformationNeighbours> weight{};  // sum 1
};

class NodeSearch;

// Reading calls may run side by side. All results are the same bytes whatever the number of
// threads.
class DeformationGraph {
 public:
  // Nodes sampled from surfels, oldest first: about one for each `spacing` of each layer of
  // surface. Throws std::invalid_argument for options that make no sense.
  static DeformationGraph sample(const SurfelArrays& surfels,
                                 const DeformationGraphOptions& options);
  // From those with these ids alone, such as what is in view.
  static DeformationGraph sample(const SurfelArrays& surfels, std::span<const std::int32_t> ids,
                                 const DeformationGraphOptions& options);
  // Of given nodes.
  DeformationGraph(std::vector<DeformationNode> nodes, const DeformationGraphOptions& options);

  const std::vector<DeformationNode>& nodes() const { return nodes_; }
  // A new motion for each node; positions and times stay.
  void set_motion(std::size_t node, const Eigen::Matrix3d& affine,
                  const Eigen::Vector3d& translation);
  // Pairs of neighbours, first < second, ascending: each node's k nearest of those seen with it,
  // and the shortest links without which nodes seen together would hang apart.
  const std::vector<std::pair<std::int32_t, std::int32_t>>& edges() const { return edges_; }
  double spacing() const { return options_.spacing; }

  Influences influences(const Eigen::Vector3d& point, const TimeSpan& seen) const;
  // What no node moves comes back as it was, to the last bit.
  Eigen::Vector3d moved(const Eigen::Vector3d& point, const TimeSpan& seen) const;
  // A camera's pose follows what is around it; its rotation by the rotation nearest to the affine
  // one.
  SE3 moved(const SE3& map_T_camera, const TimeSpan& seen) const;
  // Moves positions and normals, and returns the ids of the surfels that moved, in their order.
  std::vector<std::int32_t> apply(SurfelArrays& surfels) const;
  // Of those with these ids, each given once.
  std::vector<std::int32_t> apply(SurfelArrays& surfels, std::span<const std::int32_t> ids) const;

 private:
  void connect();

  DeformationGraphOptions options_;
  std::vector<DeformationNode> nodes_;
  std::vector<std::pair<std::int32_t, std::int32_t>> edges_;
  std::shared_ptr<const NodeSearch> search_;  // shared by copies: nodes stay where they are
};

}  // namespace gastronaut::slam

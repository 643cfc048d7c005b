#include "visual_slam/deformation_graph.hpp"

#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <unordered_map>

#include "numerics/parallel.hpp"
#include "visual_slam/deformation_search.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kMicroseconds = 1e6;  // a second
constexpr std::size_t kSurfelsAtATime = 8192;

DeformationGraphOptions checked(const DeformationGraphOptions& o) {
  if (!(o.spacing > 0 && o.time_reach > 0 && o.least_surfels > 0)) {
    throw std::invalid_argument(
        "deformation graph: spacing and time_reach must be positive, least_surfels at least 1");
  }
  return o;
}

std::int64_t time_reach_of(const DeformationGraphOptions& options) {
  return std::llround(options.time_reach * kMicroseconds);
}

std::vector<std::int32_t> all_ids(const SurfelArrays& surfels) {
  std::vector<std::int32_t> ids(surfels.size());
  std::iota(ids.begin(), ids.end(), 0);
  return ids;
}

// Surfels of one small cell that were made at about one time.
struct Patch {
  std::int64_t epoch = 0;  // utime; what follows is relative to it, so that sums are exact
  std::int64_t surfels = 0;
  std::int64_t first = 0;
  std::int64_t last = 0;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();

  DeformationNode mean() const {
    DeformationNode node;
    node.position = position / static_cast<double>(surfels);
    node.seen = {epoch + first / surfels, epoch + last / surfels};
    return node;
  }
};

struct PatchKey {
  std::int64_t x, y, z, time;
  bool operator==(const PatchKey&) const = default;
};
struct PatchHash {
  std::size_t operator()(const PatchKey& key) const {
    std::uint64_t hash = 0;
    for (const std::int64_t part : {key.x, key.y, key.z, key.time}) {
      hash = (hash ^ static_cast<std::uint64_t>(part)) * 0x9E3779B97F4A7C15ULL;  // golden ratio
      hash ^= hash >> 32;
    }
    return hash;
  }
};

// In the order of their first surfels.
std::vector<Patch> patches_of(const SurfelArrays& surfels, std::span<const std::int32_t> ids,
                              const DeformationGraphOptions& options) {
  const double cell = options.spacing / 2;
  const std::int64_t reach = time_reach_of(options);
  const auto cell_of = [cell](double x) { return static_cast<std::int64_t>(std::floor(x / cell)); };
  std::vector<Patch> patches;
  std::unordered_map<PatchKey, std::size_t, PatchHash> number_of;
  for (const std::int32_t id : ids) {
    const auto k = static_cast<std::size_t>(id);
    if (!surfels.holds(k)) continue;
    if (static_cast<double>(surfels.confidence[k]) < options.least_confidence) continue;
    const Eigen::Vector3d position =
        Eigen::Vector3f(surfels.x[k], surfels.y[k], surfels.z[k]).cast<double>();
    const std::int64_t epoch = surfels.initialised[k] / reach;
    const PatchKey key{cell_of(position.x()), cell_of(position.y()), cell_of(position.z()), epoch};
    const auto [at, is_new] = number_of.try_emplace(key, patches.size());
    if (is_new) patches.emplace_back().epoch = epoch * reach;
    Patch& patch = patches[at->second];
    patch.position += position;
    patch.first += surfels.initialised[k] - patch.epoch;
    patch.last += surfels.updated[k] - patch.epoch;
    ++patch.surfels;
  }
  return patches;
}

Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& affine) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(affine, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d signs(1, 1, (svd.matrixU() * svd.matrixV().transpose()).determinant());
  return svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
}

// By how much the motion of nodes, blended, differs from none: exactly 0 where none moves.
struct Change {
  Eigen::Matrix3d affine = Eigen::Matrix3d::Zero();  // R - 1
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();   // metres, of the point
};

Change change_at(const std::vector<DeformationNode>& nodes, const Influences& influences,
                 const Eigen::Vector3d& point) {
  Change sum;
  for (std::size_t i = 0; i < static_cast<std::size_t>(influences.count); ++i) {
    const DeformationNode& node = nodes[static_cast<std::size_t>(influences.node[i])];
    const Eigen::Matrix3d affine = node.affine - Eigen::Matrix3d::Identity();
    sum.affine += influences.weight[i] * affine;
    sum.shift += influences.weight[i] * (affine * (point - node.position) + node.translation);
  }
  return sum;
}

}  // namespace

DeformationGraph DeformationGraph::sample(const SurfelArrays& surfels,
                                          const DeformationGraphOptions& options) {
  return sample(surfels, all_ids(surfels), options);
}

DeformationGraph DeformationGraph::sample(const SurfelArrays& surfels,
                                          std::span<const std::int32_t> ids,
                                          const DeformationGraphOptions& options) {
  checked(options);
  std::vector<DeformationNode> candidates;
  for (const Patch& patch : patches_of(surfels, ids, options)) {
    if (patch.surfels >= options.least_surfels) candidates.push_back(patch.mean());
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const auto& a, const auto& b) { return a.seen.first < b.seen.first; });
  const std::int64_t reach = time_reach_of(options);
  const double spacing2 = options.spacing * options.spacing;
  std::vector<DeformationNode> nodes;
  for (const DeformationNode& candidate : candidates) {
    const bool is_covered =
        std::any_of(nodes.rbegin(), nodes.rend(), [&](const DeformationNode& node) {
          return (node.position - candidate.position).squaredNorm() < spacing2 &&
                 node.seen.gap(candidate.seen) <= reach;
        });
    if (!is_covered) nodes.push_back(candidate);
  }
  return {std::move(nodes), options};
}

DeformationGraph::DeformationGraph(std::vector<DeformationNode> nodes,
                                   const DeformationGraphOptions& options)
    : options_(checked(options)),
      nodes_(std::move(nodes)),
      search_(std::make_shared<NodeSearch>(nodes_, options.spacing, time_reach_of(options))) {
  connect();
}

void DeformationGraph::connect() {
  const std::int64_t reach = time_reach_of(options_);
  const std::size_t count = nodes_.size();
  const auto add_edge = [this](std::size_t a, std::size_t b) {
    edges_.emplace_back(static_cast<std::int32_t>(std::min(a, b)),
                        static_cast<std::int32_t>(std::max(a, b)));
  };
  // Each node's nearest; beside it, Prim's shortest trees over all that was seen together.
  constexpr double kFar = std::numeric_limits<double>::infinity();
  std::vector<double> to_tree(count, kFar);
  std::vector<std::size_t> link(count, count);
  std::vector<std::uint8_t> is_in_tree(count);
  std::vector<std::pair<double, std::size_t>> near;
  std::size_t next = 0;
  for (std::size_t grown = 0; grown < count; ++grown) {
    const std::size_t node = next;
    if (link[node] < count) add_edge(node, link[node]);
    is_in_tree[node] = 1;
    near.clear();
    next = count;
    for (std::size_t other = 0; other < count; ++other) {
      if (other == node) continue;
      if (nodes_[node].seen.gap(nodes_[other].seen) <= reach) {
        const double distance2 = (nodes_[node].position - nodes_[other].position).squaredNorm();
        near.emplace_back(distance2, other);
        if (distance2 < to_tree[other]) {
          to_tree[other] = distance2;
          link[other] = node;
        }
      }
      if (!is_in_tree[other] && (next == count || to_tree[other] < to_tree[next])) next = other;
    }
    const auto nearest =
        near.begin() + std::min<std::ptrdiff_t>(kDeformationNeighbours, std::ssize(near));
    std::partial_sort(near.begin(), nearest, near.end());
    for (auto each = near.begin(); each != nearest; ++each) add_edge(node, each->second);
  }
  std::sort(edges_.begin(), edges_.end());
  edges_.erase(std::unique(edges_.begin(), edges_.end()), edges_.end());
}

void DeformationGraph::set_motion(std::size_t node, const Eigen::Matrix3d& affine,
                                  const Eigen::Vector3d& translation) {
  nodes_[node].affine = affine;
  nodes_[node].translation = translation;
}

Influences DeformationGraph::influences(const Eigen::Vector3d& point, const TimeSpan& seen) const {
  return search_->influences(point, seen);
}

Eigen::Vector3d DeformationGraph::moved(const Eigen::Vector3d& point, const TimeSpan& seen) const {
  return point + change_at(nodes_, influences(point, seen), point).shift;
}

SE3 DeformationGraph::moved(const SE3& map_T_camera, const TimeSpan& seen) const {
  const Eigen::Vector3d& point = map_T_camera.translation;
  const Change change = change_at(nodes_, influences(point, seen), point);
  if (change.affine.isZero(0)) return {map_T_camera.rotation, point + change.shift};
  const Eigen::Quaterniond turn(nearest_rotation(Eigen::Matrix3d::Identity() + change.affine));
  return {(turn * map_T_camera.rotation).normalized(), point + change.shift};
}

std::vector<std::int32_t> DeformationGraph::apply(SurfelArrays& surfels) const {
  return apply(surfels, all_ids(surfels));
}

std::vector<std::int32_t> DeformationGraph::apply(SurfelArrays& surfels,
                                                  std::span<const std::int32_t> ids) const {
  // Each node's motion as a change: of p by (R - 1) p + t - (R - 1) g, of n by (R^-T - 1) n.
  struct NodeChange {
    Eigen::Matrix3d affine;
    Eigen::Vector3d shift;
    Eigen::Matrix3d of_normals;
  };
  std::vector<NodeChange> changes;
  bool is_still = true;
  for (const DeformationNode& node : nodes_) {
    const Eigen::Matrix3d affine = node.affine - Eigen::Matrix3d::Identity();
    changes.push_back({affine, node.translation - affine * node.position,
                       node.affine.inverse().transpose() - Eigen::Matrix3d::Identity()});
    is_still = is_still && affine.isZero(0) && node.translation.isZero(0);
  }
  if (is_still) return {};

  const auto move = [&](std::size_t begin, std::size_t end) {
    std::vector<std::int32_t> moved_ids;
    for (const std::int32_t id : ids.subspan(begin, end - begin)) {
      const auto k = static_cast<std::size_t>(id);
      if (!surfels.holds(k)) continue;
      const Eigen::Vector3f old_position(surfels.x[k], surfels.y[k], surfels.z[k]);
      const Eigen::Vector3f old_normal(surfels.nx[k], surfels.ny[k], surfels.nz[k]);
      const Eigen::Vector3d point = old_position.cast<double>();
      const Eigen::Vector3d direction = old_normal.cast<double>();
      const Influences near = influences(point, {surfels.initialised[k], surfels.updated[k]});
      Eigen::Vector3d shift = Eigen::Vector3d::Zero();
      Eigen::Vector3d turn = Eigen::Vector3d::Zero();
      for (std::size_t i = 0; i < static_cast<std::size_t>(near.count); ++i) {
        const NodeChange& change = changes[static_cast<std::size_t>(near.node[i])];
        shift += near.weight[i] * (change.affine * point + change.shift);
        turn += near.weight[i] * (change.of_normals * direction);
      }
      const Eigen::Vector3f position = (point + shift).cast<float>();
      const Eigen::Vector3f normal =
          turn.isZero(0) ? old_normal : (direction + turn).normalized().cast<float>();
      if (position == old_position && normal == old_normal) continue;
      surfels.x[k] = position.x();
      surfels.y[k] = position.y();
      surfels.z[k] = position.z();
      surfels.nx[k] = normal.x();
      surfels.ny[k] = normal.y();
      surfels.nz[k] = normal.z();
      moved_ids.push_back(id);
    }
    return moved_ids;
  };
  return parallel_reduce_in_order(ids.size(), kSurfelsAtATime, std::vector<std::int32_t>{}, move,
                                  [](auto all, const auto& more) {
                                    all.insert(all.end(), more.begin(), more.end());
                                    return all;
                                  });
}

}  // namespace gastronaut::slam

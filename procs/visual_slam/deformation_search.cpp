#include "visual_slam/deformation_search.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <tuple>

namespace gastronaut::slam {
namespace {

constexpr std::size_t kCellsAcross = 64;  // at most
constexpr std::size_t kListed = 64;       // nodes around a cell

}  // namespace

// The k + 1 first by (time apart, distance, number).
struct NodeSearch::Nearest {
  struct Entry {
    std::int64_t apart;  // microseconds beyond the reach
    double distance2;
    std::int32_t node;
    bool operator<(const Entry& other) const {
      return std::tie(apart, distance2, node) < std::tie(other.apart, other.distance2, other.node);
    }
  };
  std::array<Entry, kDeformationNeighbours + 1> entries;
  std::size_t count = 0;

  bool is_full() const { return count == entries.size(); }
  void insert(const Entry& entry) {
    if (is_full() && !(entry < entries[count - 1])) return;
    std::size_t at = is_full() ? count - 1 : count++;
    for (; at > 0 && entry < entries[at - 1]; --at) entries[at] = entries[at - 1];
    entries[at] = entry;
  }
};

NodeSearch::NodeSearch(const std::vector<DeformationNode>& nodes, double spacing,
                       std::int64_t time_reach)
    : time_reach_(time_reach), spacing_(spacing) {
  if (nodes.empty()) return;
  Eigen::Vector3d highest = nodes.front().position;
  origin_ = highest;
  for (const DeformationNode& node : nodes) {
    places_.push_back({node.position, node.seen});
    origin_ = origin_.cwiseMin(node.position);
    highest = highest.cwiseMax(node.position);
  }
  cell_ = std::max(spacing, (highest - origin_).maxCoeff() / static_cast<double>(kCellsAcross - 1));
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto i = static_cast<Eigen::Index>(axis);
    cells_[axis] = 1 + static_cast<std::size_t>((highest[i] - origin_[i]) / cell_);
  }
  lists_ = std::vector<std::atomic<const List*>>(cells_[0] * cells_[1] * cells_[2]);
}

NodeSearch::~NodeSearch() {
  for (const auto& list : lists_) delete list.load();
}

const NodeSearch::List& NodeSearch::list(std::size_t cell, const Eigen::Vector3d& centre) const {
  if (const List* made = lists_[cell].load(std::memory_order_acquire)) return *made;
  auto fresh = std::make_unique<List>();
  fresh->reserve(places_.size());
  for (std::size_t n = 0; n < places_.size(); ++n) {
    fresh->push_back({(places_[n].position - centre).norm(), static_cast<std::int32_t>(n)});
  }
  const std::size_t kept = std::min(kListed, fresh->size());
  std::partial_sort(fresh->begin(), fresh->begin() + static_cast<std::ptrdiff_t>(kept),
                    fresh->end(), [](const Listed& a, const Listed& b) {
                      return std::tie(a.distance, a.node) < std::tie(b.distance, b.node);
                    });
  fresh->resize(kept);
  fresh->shrink_to_fit();
  // Another thread may have been faster: its list is the same.
  const List* expected = nullptr;
  if (lists_[cell].compare_exchange_strong(expected, fresh.get(), std::memory_order_acq_rel)) {
    return *fresh.release();
  }
  return *expected;
}

Influences NodeSearch::influences(const Eigen::Vector3d& point, const TimeSpan& seen) const {
  Influences result;
  if (places_.empty() || !point.allFinite()) return result;
  std::size_t cell = 0;
  Eigen::Vector3d centre;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const auto i = static_cast<Eigen::Index>(axis);
    const double most = static_cast<double>(cells_[axis] - 1);
    const double at = std::clamp(std::floor((point[i] - origin_[i]) / cell_), 0.0, most);
    cell = cell * cells_[axis] + static_cast<std::size_t>(at);
    centre[i] = origin_[i] + (at + 0.5) * cell_;
  }

  Nearest nearest;
  const double from_centre = (point - centre).norm();
  const List& listed = list(cell, centre);
  bool is_complete = listed.size() == places_.size();
  for (const Listed& each : listed) {
    // What follows in the list is farther than the farthest found.
    const double least = each.distance - from_centre;
    if (nearest.is_full() && least > 0 && least * least > nearest.entries.back().distance2) {
      is_complete = true;
      break;
    }
    const Place& place = places_[static_cast<std::size_t>(each.node)];
    const double distance2 = (place.position - point).squaredNorm();
    if (nearest.is_full() && distance2 > nearest.entries.back().distance2) continue;
    if (place.seen.gap(seen) <= time_reach_) nearest.insert({0, distance2, each.node});
  }
  if (!is_complete || nearest.count == 0) {
    nearest.count = 0;
    for (std::size_t n = 0; n < places_.size(); ++n) {
      nearest.insert({std::max(std::int64_t{0}, places_[n].seen.gap(seen) - time_reach_),
                      (places_[n].position - point).squaredNorm(), static_cast<std::int32_t>(n)});
    }
    // Those seen at another time stand in only where none was seen at this one.
    while (nearest.entries[nearest.count - 1].apart > 0 && nearest.entries[0].apart == 0) {
      --nearest.count;
    }
  }

  double farthest2 = 0;
  for (std::size_t i = 0; i < nearest.count; ++i) {
    farthest2 = std::max(farthest2, nearest.entries[i].distance2);
  }
  // Where there is no next node, d_max is as if it came a spacing later.
  const double reach = std::sqrt(farthest2) + (nearest.is_full() ? 0 : spacing_);
  const std::size_t used = std::min(nearest.count, result.node.size());
  double sum = 0;
  for (std::size_t i = 0; i < used; ++i) {
    const double rest = 1 - std::sqrt(nearest.entries[i].distance2) / reach;
    result.node[i] = nearest.entries[i].node;
    result.weight[i] = rest * rest;
    sum += result.weight[i];
  }
  for (std::size_t i = 0; i < used; ++i) {
    // All equally far: all count alike.
    result.weight[i] = sum > 0 ? result.weight[i] / sum : 1 / static_cast<double>(used);
  }
  result.count = static_cast<int>(used);
  return result;
}

}  // namespace gastronaut::slam

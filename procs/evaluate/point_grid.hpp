// Points in a grid of cubes, to find those near a place.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <tuple>
#include <vector>

namespace gastronaut::evaluation {

class PointGrid {
 public:
  // `side` of the cubes: metres, as far as one wants to look.
  PointGrid(std::span<const Eigen::Vector3d> points, double side) : side_(side) {
    entries_.reserve(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
      entries_.push_back({cell_of(points[i]), points[i], i});
    }
    std::sort(entries_.begin(), entries_.end(), [](const Entry& a, const Entry& b) {
      return std::tie(a.cell, a.index) < std::tie(b.cell, b.index);
    });
  }

  // visit(index, point) for all within `side` of the place, and for others that are not much
  // further. In an order that goes by the points alone.
  template <class Visit>
  void visit_around(const Eigen::Vector3d& place, const Visit& visit) const {
    const Cell centre = cell_of(place);
    for (std::int64_t x = -1; x <= 1; ++x) {
      for (std::int64_t y = -1; y <= 1; ++y) {
        // The cubes z - 1 to z + 1 follow each other.
        const Cell first = {centre[0] + x, centre[1] + y, centre[2] - 1};
        const Cell last = {first[0], first[1], centre[2] + 1};
        auto entry =
            std::lower_bound(entries_.begin(), entries_.end(), first,
                             [](const Entry& e, const Cell& wanted) { return e.cell < wanted; });
        for (; entry != entries_.end() && entry->cell <= last; ++entry) {
          visit(entry->index, entry->point);
        }
      }
    }
  }

 private:
  using Cell = std::array<std::int64_t, 3>;
  struct Entry {
    Cell cell;
    Eigen::Vector3d point;
    std::size_t index;
  };

  Cell cell_of(const Eigen::Vector3d& point) const {
    const Eigen::Vector3d scaled = point / side_;
    return {std::llround(scaled.x()), std::llround(scaled.y()), std::llround(scaled.z())};
  }

  double side_;
  std::vector<Entry> entries_;
};

}  // namespace gastronaut::evaluation

#include "visual_slam/wall_motion.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

namespace gastronaut::slam {
namespace {

struct Patch {
  bool is_known = false;
  bool is_even = false;   // the whole of it went one way, or none
  double change = 0;      // median logarithm of measured against predicted depth
  std::size_t pixel = 0;  // its middle
  double depth = 0;       // metres, predicted, at
  Eigen::Vector3d ray;    // the middle of the patch; z = 1
  Eigen::Vector3d normal;
  int piece = -1;
};

double median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

class Patches {
 public:
  Patches(const Frame& frame, const ModelView& view, const WallMotionOptions& options)
      : side_(std::max(1, frame.grid.width / options.patches)),
        columns_(frame.grid.width / side_),
        rows_(frame.grid.height / side_) {
    for (int row = 0; row < rows_; ++row) {
      for (int column = 0; column < columns_; ++column) {
        patches_.push_back(look(frame, view, column * side_, row * side_, options));
      }
    }
  }

  // Numbers the pieces of neighbours that have moved the same way; returns their sizes.
  std::vector<int> pieces(double least_change) {
    std::vector<int> sizes;
    for (std::size_t seed = 0; seed < patches_.size(); ++seed) {
      if (!has_moved(patches_[seed], least_change) || patches_[seed].piece >= 0) continue;
      const int piece = static_cast<int>(sizes.size());
      sizes.push_back(0);
      std::vector<std::size_t> open{seed};
      patches_[seed].piece = piece;
      while (!open.empty()) {
        const std::size_t at = open.back();
        open.pop_back();
        ++sizes.back();
        const int column = static_cast<int>(at) % columns_;
        const int row = static_cast<int>(at) / columns_;
        constexpr std::pair<int, int> kSteps[] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};
        for (const auto& [du, dv] : kSteps) {
          const int u = column + du;
          const int v = row + dv;
          if (u < 0 || v < 0 || u >= columns_ || v >= rows_) continue;
          const auto next = static_cast<std::size_t>(v * columns_ + u);
          Patch& patch = patches_[next];
          if (patch.piece >= 0 || !has_moved(patch, least_change) ||
              (patch.change > 0) != (patches_[at].change > 0)) {
            continue;
          }
          patch.piece = piece;
          open.push_back(next);
        }
      }
    }
    return sizes;
  }

  const std::vector<Patch>& all() const { return patches_; }

 private:
  static bool has_moved(const Patch& patch, double least_change) {
    return patch.is_known && patch.is_even && std::abs(patch.change) > least_change;
  }

  Patch look(const Frame& frame, const ModelView& view, int left, int top,
             const WallMotionOptions& options) const {
    Patch patch;
    std::vector<double> changes;
    std::vector<double> depths;
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();
    for (int v = top; v < top + side_; ++v) {
      for (int u = left; u < left + side_; ++u) {
        const auto measured = static_cast<double>(frame.depth.at(u, v));
        const auto predicted = static_cast<double>(view.depth.at(u, v));
        if (!(measured > 0) || !(predicted > 0)) continue;
        changes.push_back(std::log(measured / predicted));
        depths.push_back(predicted);
        normal +=
            Eigen::Vector3f(view.normal_x.at(u, v), view.normal_y.at(u, v), view.normal_z.at(u, v))
                .cast<double>();
      }
    }
    const double known = static_cast<double>(changes.size());
    if (known < options.least_known * side_ * side_ || !(normal.norm() > 0)) return patch;
    patch.change = median(changes);
    patch.depth = median(depths);
    for (double& change : changes) change = std::abs(change - patch.change);
    const double scatter = median(changes);
    patch.is_known = std::abs(patch.change) < options.largest;
    patch.is_even = std::abs(patch.change) > options.least_share * scatter;
    const PinholeGrid& grid = frame.grid;
    patch.pixel = static_cast<std::size_t>(top + side_ / 2) * static_cast<std::size_t>(grid.width) +
                  static_cast<std::size_t>(left + side_ / 2);
    patch.ray = {(left + (side_ - 1) / 2.0 - grid.cx) / grid.fx,
                 (top + (side_ - 1) / 2.0 - grid.cy) / grid.fy, 1};
    patch.normal = normal.normalized();
    return patch;
  }

  int side_;  // pixels
  int columns_;
  int rows_;
  std::vector<Patch> patches_;
};

}  // namespace

std::vector<WallPatch> find_wall_motion(const Frame& keyframe, const ModelView& view,
                                        const WallMotionOptions& options) {
  const double least_change = options.least_sigmas * keyframe.relative_std;
  Patches patches(keyframe, view, options);
  const std::vector<int> sizes = patches.pieces(least_change);
  const auto is_company = [&](int size) { return size >= options.least_patches; };
  if (std::none_of(sizes.begin(), sizes.end(), is_company)) return {};
  std::vector<WallPatch> wall;
  for (const Patch& patch : patches.all()) {
    if (!patch.is_known) continue;
    const bool has_moved =
        patch.piece >= 0 && is_company(sizes[static_cast<std::size_t>(patch.piece)]);
    const double ratio = has_moved ? std::exp(patch.change) : 1;
    wall.push_back(
        {patch.pixel, patch.depth * patch.ray, ratio * patch.depth * patch.ray, patch.normal});
  }
  return wall;
}

}  // namespace gastronaut::slam

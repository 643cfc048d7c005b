#include "visual_slam/window_texture.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>

#include "numerics/parallel.hpp"

namespace gastronaut::slam {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
constexpr std::size_t kRowsAtOnce = 16;
constexpr float kLeastShare = 0.5F;  // of the contrast's window that must not be masked
// The patch of a point, pixels from its middle: as in DSO.
constexpr std::array<std::array<int, 2>, kPatchPixels> kPatch = {
    {{0, 0}, {-2, 0}, {2, 0}, {0, -2}, {0, 2}, {-1, -1}, {1, -1}, {-1, 1}}};
constexpr int kLeastSide = 5;  // pixels between points, about: closer ones see the same
constexpr int kBorder = 3;     // pixels around a point that must be in the picture

bool is_depth(float depth) { return depth > 0 && std::isfinite(depth); }
bool is_albedo(float albedo) { return albedo >= 0 && std::isfinite(albedo); }

template <class Body>
void for_rows(int height, const Body& body) {
  parallel_for_chunks(static_cast<std::size_t>(height), kRowsAtOnce,
                      [&](std::size_t begin, std::size_t end) {
                        body(static_cast<int>(begin), static_cast<int>(end));
                      });
}

Plane<float> normalised(const Plane<float>& albedo, int reach, float floor) {
  const int width = albedo.width;
  const int height = albedo.height;
  const auto side = static_cast<float>(2 * reach + 1);
  Plane<float> result(width, height, kNone);
  for_rows(height, [&](int begin, int end) {
    // Down the window's columns: how many are not masked, their sum and sum of squares.
    std::vector<float> count(static_cast<std::size_t>(width));
    std::vector<float> first(count.size());
    std::vector<float> second(count.size());
    for (int v = std::max(begin, reach); v < std::min(end, height - reach); ++v) {
      for (auto* sums : {&count, &first, &second}) std::fill(sums->begin(), sums->end(), 0.0F);
      for (int j = v - reach; j <= v + reach; ++j) {
        const float* row = albedo.row(j);
        for (std::size_t u = 0; u < count.size(); ++u) {
          const float seen = is_albedo(row[u]) ? 1.0F : 0.0F;
          const float value = is_albedo(row[u]) ? row[u] : 0.0F;
          count[u] += seen;
          first[u] += value;
          second[u] += value * value;
        }
      }
      const float* row = albedo.row(v);
      for (int u = reach; u < width - reach; ++u) {
        float n = 0;
        float s = 0;
        float ss = 0;
        for (int i = u - reach; i <= u + reach; ++i) {
          n += count[static_cast<std::size_t>(i)];
          s += first[static_cast<std::size_t>(i)];
          ss += second[static_cast<std::size_t>(i)];
        }
        if (!is_albedo(row[u]) || n < kLeastShare * side * side) continue;
        const float mean = s / n;
        const float spread = std::sqrt(std::max(0.0F, ss / n - mean * mean)) + floor * mean;
        if (spread > 0) result.at(u, v) = (row[u] - mean) / spread;
      }
    }
  });
  return result;
}

// Nothing where the patch is cut or lies on two surfaces.
bool make_point(const Texture& texture, int u, int v, double jump, WindowPoint& point) {
  const auto at = [&](int column, int row) {
    return texture
        .texels[static_cast<std::size_t>(row) * static_cast<std::size_t>(texture.grid.width) +
                static_cast<std::size_t>(column)];
  };
  point.u = u;
  point.v = v;
  const float middle = at(u, v).depth;
  for (std::size_t i = 0; i < kPatchPixels; ++i) {
    const int column = u + kPatch[i][0];
    const int row = v + kPatch[i][1];
    const Texel texel = at(column, row);
    const double reach = jump * std::hypot(kPatch[i][0], kPatch[i][1]) * middle;
    if (!(std::fabs(texel.depth - middle) <= reach) || !std::isfinite(texel.value)) return false;
    point.ray_x[i] = static_cast<float>((column - texture.grid.cx) / texture.grid.fx);
    point.ray_y[i] = static_cast<float>((row - texture.grid.cy) / texture.grid.fy);
    point.depth[i] = texel.depth;
    point.value[i] = texel.value;
  }
  return true;
}

std::vector<WindowPoint> steepest_in_squares(const Texture& texture, int side,
                                             double least_gradient, double jump) {
  const PinholeGrid& grid = texture.grid;
  std::vector<WindowPoint> selected;
  for (int top = kBorder; top + kBorder < grid.height; top += side) {
    for (int left = kBorder; left + kBorder < grid.width; left += side) {
      auto steepest = static_cast<float>(least_gradient * least_gradient);
      WindowPoint best;
      bool found = false;
      for (int v = top; v < std::min(top + side, grid.height - kBorder); ++v) {
        for (int u = left; u < std::min(left + side, grid.width - kBorder); ++u) {
          const Texel& texel = texture.texels[static_cast<std::size_t>(v * grid.width + u)];
          const float steepness =
              texel.gradient_x * texel.gradient_x + texel.gradient_y * texel.gradient_y;
          WindowPoint point;
          if (!(steepness > steepest) || !make_point(texture, u, v, jump, point)) continue;
          steepest = steepness;
          best = point;
          found = true;
        }
      }
      if (found) selected.push_back(best);
    }
  }
  return selected;
}

}  // namespace

Texture texture_of(const Frame& frame, int reach, double floor) {
  const PinholeGrid& grid = frame.grid;
  const Plane<float> albedo = normalised(frame.albedo, reach, static_cast<float>(floor));
  Texture texture{grid, std::vector<Texel>(frame.depth.size(), {kNone, kNone, kNone, kNone})};
  for (int v = 0; v < grid.height; ++v) {
    Texel* to = texture.texels.data() + static_cast<std::ptrdiff_t>(v) * grid.width;
    const float* row = albedo.row(v);
    const float* depth = frame.depth.row(v);
    const bool inside = v > 0 && v + 1 < grid.height;
    for (int u = 0; u < grid.width; ++u) {
      to[u].value = row[u];
      if (is_depth(depth[u])) to[u].depth = depth[u];
      if (!inside || u == 0 || u + 1 == grid.width) continue;
      to[u].gradient_x = (row[u + 1] - row[u - 1]) / 2;
      to[u].gradient_y = (row[u + grid.width] - row[u - grid.width]) / 2;
    }
  }
  return texture;
}

std::vector<WindowPoint> select_points(const Texture& texture, int points, double least_gradient,
                                       double jump) {
  const double area = static_cast<double>(texture.grid.width) * texture.grid.height;
  const double side = std::sqrt(area / points);
  const auto select = [&](double pixels) {
    return steepest_in_squares(texture, std::max(kLeastSide, static_cast<int>(pixels)),
                               least_gradient, jump);
  };
  std::vector<WindowPoint> selected = select(side);
  const double share = static_cast<double>(selected.size()) / points;
  if (share < 1 && !selected.empty()) selected = select(side * std::sqrt(share));
  return selected;
}

}  // namespace gastronaut::slam

#include "visual_slam/surfel_normals.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "numerics/parallel.hpp"

namespace gastronaut::slam {
namespace {

constexpr int kReach = 2;  // pixels: the window is 5 x 5
constexpr std::size_t kBandHeight = 16;
// Determinant of the slopes' normal matrix: 25 * 25 with all pairs, 3 * 3 with all next to it.
constexpr float kLeastDeterminant = 9;

struct RowSums {
  std::vector<float> uu, uv, vv, u, v;

  explicit RowSums(std::size_t width) : uu(width), uv(width), vv(width), u(width), v(width) {}
  void clear() {
    for (auto* sum : {&uu, &uv, &vv, &u, &v}) std::fill(sum->begin(), sum->end(), 0.0F);
  }
};

// Adds the pairs at (i, j) and (-i, -j) from each middle pixel of a row.
void add_pairs(const float* __restrict middle, const float* __restrict ahead,
               const float* __restrict back, int i, int j, float bend, int width, RowSums& sums) {
  const auto fi = static_cast<float>(i);
  const auto fj = static_cast<float>(j);
  float* __restrict uu = sums.uu.data();
  float* __restrict uv = sums.uv.data();
  float* __restrict vv = sums.vv.data();
  float* __restrict u_sum = sums.u.data();
  float* __restrict v_sum = sums.v.data();
  const int margin = std::abs(i);
  for (int u = margin; u < width - margin; ++u) {
    const float a = ahead[u + i];
    const float b = back[u - i];
    const float m = middle[u];
    // What is missing is NaN, and compares false.
    const bool counts = std::abs(a + b - 2 * m) <= 2 * bend * m;
    const float slope = counts ? (a - b) * 0.5F : 0.0F;
    const float one = counts ? 1.0F : 0.0F;
    uu[u] += one * (fi * fi);
    uv[u] += one * (fi * fj);
    vv[u] += one * (fj * fj);
    u_sum[u] += fi * slope;
    v_sum[u] += fj * slope;
  }
}

}  // namespace

void estimate_normals(const Plane<float>& depth, const PinholeGrid& grid, double bend,
                      NormalMap& normals) {
  const int width = grid.width;
  for (Plane<float>* plane : {&normals.x, &normals.y, &normals.z}) {
    *plane = Plane<float>(width, grid.height);
  }
  Plane<float> inverse(width, grid.height);
  for (std::size_t k = 0; k < inverse.size(); ++k) {
    const float d = depth.values[k];
    const bool any = d > 0 && d <= std::numeric_limits<float>::max();
    inverse.values[k] = any ? 1 / d : std::numeric_limits<float>::quiet_NaN();
  }

  const auto fx = static_cast<float>(grid.fx);
  const auto fy = static_cast<float>(grid.fy);
  const auto rows = static_cast<std::size_t>(grid.height);
  parallel_for_chunks(rows, kBandHeight, [&](std::size_t begin, std::size_t end) {
    RowSums sums(static_cast<std::size_t>(width));
    for (int v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
      sums.clear();
      const float* middle = inverse.row(v);
      for (int j = 0; j <= kReach; ++j) {
        if (v - j < 0 || v + j >= grid.height) continue;
        for (int i = j == 0 ? 1 : -kReach; i <= kReach; ++i) {
          add_pairs(middle, inverse.row(v + j), inverse.row(v - j), i, j, static_cast<float>(bend),
                    width, sums);
        }
      }
      const float y = (static_cast<float>(v) - static_cast<float>(grid.cy)) / fy;
      for (int u = 0; u < width; ++u) {
        const auto k = static_cast<std::size_t>(u);
        const float determinant = sums.uu[k] * sums.vv[k] - sums.uv[k] * sums.uv[k];
        if (determinant < kLeastDeterminant) continue;
        const float x = (static_cast<float>(u) - static_cast<float>(grid.cx)) / fx;
        const float slope_x = fx * (sums.vv[k] * sums.u[k] - sums.uv[k] * sums.v[k]) / determinant;
        const float slope_y = fy * (sums.uu[k] * sums.v[k] - sums.uv[k] * sums.u[k]) / determinant;
        // 1 / z = (n . ray) / (n . P): its slopes are n's direction, and its value the rest.
        const float along = middle[u] - slope_x * x - slope_y * y;
        const float scale = -1 / std::sqrt(slope_x * slope_x + slope_y * slope_y + along * along);
        normals.x.at(u, v) = slope_x * scale;
        normals.y.at(u, v) = slope_y * scale;
        normals.z.at(u, v) = along * scale;
      }
    }
  });
}

}  // namespace gastronaut::slam

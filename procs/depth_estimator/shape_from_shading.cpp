#include "depth_estimator/shape_from_shading.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "numerics/parallel.hpp"

namespace gastronaut::perception {
namespace {

constexpr int kCoarsestSide = 24;  // pixels: the pyramid ends below
// Grids below this many pixels are faster on one thread. The finest of them is where the last
// picture's depth comes in.
constexpr int kSmallGrid = 10000;
constexpr int kRowsPerChunk = 24;
constexpr float kCauchy = 2;          // sigmas of the data
constexpr float kDamping = 1e-3F;     // keeps a pixel without data or curvature solvable
constexpr float kCosineFloor = 0.1F;  // patches turned further from the light are in its shadow
constexpr float kLargestStep = 0.3F;  // of zeta, in one Gauss-Newton step
constexpr std::size_t kLeastDataBelow = 2;  // of four pixels, for a coarser one to have data
constexpr double kLeastData = 0.02;         // of the coarsest pixels, for a picture to have a shape
// Where ln light changes by this much from one pixel to the next, the wall may bend sharply:
// curvature costs half.
constexpr float kEdge = 0.15F;
// The start is this part the last picture's shape, less where the two differ by more than the gate
// (of zeta): evens out what one picture cannot tell. The scale is this picture's own.
constexpr float kMemory = 0.65F;
constexpr float kMemoryGate = 0.3F;

// Gauss-Newton steps and conjugate-gradient steps in each: many where a pixel is wide and costs
// little, few where only detail is left to find. More of the latter do not make the depth better:
// measured, stopping early is a regulariser of its own.
struct Effort {
  int largest_grid;  // pixels
  int steps;
  int inner_steps;
};
constexpr std::array<Effort, 5> kEfforts = {{{700, 10, 30},
                                             {3000, 8, 25},
                                             {kSmallGrid, 4, 20},
                                             {40000, 2, 10},
                                             {std::numeric_limits<int>::max(), 1, 6}}};

int pixels(const ShapeGrid& grid) { return grid.camera.width * grid.camera.height; }

Effort effort_for(const ShapeGrid& grid) {
  return *std::find_if(kEfforts.begin(), kEfforts.end(),
                       [&](const Effort& effort) { return pixels(grid) <= effort.largest_grid; });
}

int rows_per_chunk(const ShapeGrid& grid) {
  return pixels(grid) <= kSmallGrid ? std::max(1, grid.camera.height) : kRowsPerChunk;
}

// Median of the first `count` of up to four values: specks do not reach the coarse grids.
float middle(std::array<float, 4>& values, std::size_t count) {
  std::sort(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(count));
  return (values[(count - 1) / 2] + values[count / 2]) / 2;
}

template <class Body>
void for_rows(const ShapeGrid& grid, const Body& body) {
  parallel_for_chunks(static_cast<std::size_t>(grid.camera.height),
                      static_cast<std::size_t>(rows_per_chunk(grid)),
                      [&](std::size_t begin, std::size_t end) {
                        body(static_cast<int>(begin), static_cast<int>(end));
                      });
}

template <class Body>
double sum_rows(const ShapeGrid& grid, const Body& body) {
  return parallel_reduce_in_order(
      static_cast<std::size_t>(grid.camera.height), static_cast<std::size_t>(rows_per_chunk(grid)),
      0.0,
      [&](std::size_t begin, std::size_t end) {
        return body(static_cast<int>(begin), static_cast<int>(end));
      },
      [](double a, double b) { return a + b; });
}

}  // namespace

ShapeGrid::ShapeGrid(const PinholeGrid& grid)
    : camera(grid), padded_width(BorderedPlane::padded(grid.width)) {
  for (BorderedPlane* plane : {&zeta,
                               &log_light,
                               &inverse_variance,
                               &edge,
                               &own_c,
                               &left_c,
                               &right_c,
                               &up_c,
                               &down_c,
                               &weighted_residual,
                               &residual,
                               &smooth_x,
                               &smooth_y,
                               &smooth_xy,
                               &second_x,
                               &second_y,
                               &second_xy,
                               &a00,
                               &a10,
                               &a20,
                               &a01,
                               &a02,
                               &a11,
                               &am11,
                               &inverse_diagonal,
                               &step,
                               &direction,
                               &product,
                               &remainder,
                               &preconditioned}) {
    *plane = BorderedPlane(grid.width, grid.height);
  }
  const auto columns = static_cast<std::size_t>(padded_width);
  for (std::vector<float>* column : {&ray_x, &left, &own, &right, &has_second, &has_mixed}) {
    column->assign(columns, 0.0F);
  }
  const auto fx = static_cast<float>(grid.fx);
  for (int i = 0; i < grid.width; ++i) {
    const auto u = static_cast<std::size_t>(i);
    const bool first = i == 0;
    const bool last = i == grid.width - 1;
    ray_x[u] = static_cast<float>((i - grid.cx) / grid.fx);
    left[u] = first ? 0 : (last ? -fx : -fx / 2);
    right[u] = last ? 0 : (first ? fx : fx / 2);
    own[u] = -(left[u] + right[u]);
    has_second[u] = first || last ? 0.0F : 1.0F;
    has_mixed[u] = last ? 0.0F : 1.0F;
  }
}

ShapeFromShading::ShapeFromShading(const PinholeGrid& grid, const NearLight& light,
                                   const DepthEstimatorConfiguration& options)
    : options_(options) {
  for (const Eigen::Vector3d& position : light.positions()) {
    lights_.x.push_back(static_cast<float>(position.x()));
    lights_.y.push_back(static_cast<float>(position.y()));
  }
  lights_.lobe = static_cast<float>(light.lobe());
  PinholeGrid level = grid;
  grids_.emplace_back(level);
  while (std::min(level.width, level.height) >= kCoarsestSide) {
    level = level.coarser(2);
    grids_.emplace_back(level);
  }
  const auto small = std::find_if(grids_.begin(), grids_.end(), [](const ShapeGrid& small_grid) {
    return pixels(small_grid) <= kSmallGrid;
  });
  memory_level_ = static_cast<std::size_t>(small - grids_.begin());
}

std::optional<Shape> ShapeFromShading::solve(const Shading& shading) {
  load(shading);
  if (!start_coarsest()) return std::nullopt;
  for (std::size_t level = grids_.size(); level-- > 0;) {
    ShapeGrid& grid = grids_[level];
    if (level + 1 < grids_.size()) refine_from(grids_[level + 1], grid);
    if (level == memory_level_) recall(grid);
    const Effort effort = effort_for(grid);
    minimise(grid, effort.steps, effort.inner_steps);
  }
  ShapeGrid& fine = grids_.front();
  // The residuals of the depth that is given, not of the one before the last step.
  for_rows(fine, [&](int begin, int end) { linearise(fine, lights_, weights(), begin, end); });
  Shape shape;
  shape.depth = Plane<float>(fine.camera.width, fine.camera.height);
  shape.log_shading = Plane<float>(fine.camera.width, fine.camera.height);
  for_rows(fine, [&](int begin, int end) {
    for (int v = begin; v < end; ++v) {
      const float* zeta = fine.zeta.row(v);
      const float* log_light = fine.log_light.row(v);
      const float* residual = fine.residual.row(v);
      for (int u = 0; u < fine.camera.width; ++u) {
        shape.depth.at(u, v) = std::exp(zeta[u]);
        shape.log_shading.at(u, v) = log_light[u] - residual[u];
      }
    }
  });
  return shape;
}

void ShapeFromShading::remember() { memory_ = grids_[memory_level_].zeta; }

void ShapeFromShading::recall(ShapeGrid& grid) const {
  if (memory_.stride() == 0) return;
  std::vector<float> differences;
  for (int v = 0; v < grid.camera.height; ++v) {
    for (int u = 0; u < grid.camera.width; ++u) {
      if (grid.inverse_variance.row(v)[u] == 0) continue;
      differences.push_back(memory_.row(v)[u] - grid.zeta.row(v)[u]);
    }
  }
  if (differences.empty()) return;
  const auto middle_one = differences.begin() + static_cast<std::ptrdiff_t>(differences.size() / 2);
  std::nth_element(differences.begin(), middle_one, differences.end());
  const float common = *middle_one;
  for (int v = 0; v < grid.camera.height; ++v) {
    const float* last = memory_.row(v);
    float* zeta = grid.zeta.row(v);
    for (int u = 0; u < grid.camera.width; ++u) {
      const float difference = last[u] - zeta[u] - common;
      const float gate = difference / kMemoryGate;
      zeta[u] += kMemory / (1 + gate * gate) * difference;
    }
  }
}

void ShapeFromShading::load(const Shading& shading) {
  ShapeGrid& fine = grids_.front();
  for (int v = 0; v < fine.camera.height; ++v) {
    std::copy_n(shading.log_light.row(v), fine.camera.width, fine.log_light.row(v));
    std::copy_n(shading.inverse_variance.row(v), fine.camera.width, fine.inverse_variance.row(v));
  }
  for (std::size_t level = 1; level < grids_.size(); ++level) {
    const ShapeGrid& from = grids_[level - 1];
    ShapeGrid& to = grids_[level];
    for_rows(to, [&](int begin, int end) {
      for (int v = begin; v < end; ++v) {
        for (int u = 0; u < to.camera.width; ++u) {
          std::array<float, 4> lights{};
          float weights = 0;
          std::size_t count = 0;
          for (int k = 0; k < 4; ++k) {
            const float weight = from.inverse_variance.row(2 * v + k / 2)[2 * u + k % 2];
            if (weight == 0) continue;
            lights[count++] = from.log_light.row(2 * v + k / 2)[2 * u + k % 2];
            weights += weight;
          }
          const bool has_data = count >= kLeastDataBelow;
          to.log_light.row(v)[u] = has_data ? middle(lights, count) : 0;
          to.inverse_variance.row(v)[u] = has_data ? weights / static_cast<float>(count) : 0;
        }
      }
    });
  }
  for (ShapeGrid& grid : grids_) find_edges(grid);
}

void ShapeFromShading::find_edges(ShapeGrid& grid) {
  const int last_u = grid.camera.width - 1;
  const int last_v = grid.camera.height - 1;
  for_rows(grid, [&](int begin, int end) {
    for (int v = begin; v < end; ++v) {
      const float* light = grid.log_light.row(v);
      const float* above = grid.log_light.row(std::max(v - 1, 0));
      const float* below = grid.log_light.row(std::min(v + 1, last_v));
      const float* known = grid.inverse_variance.row(v);
      const float* known_above = grid.inverse_variance.row(std::max(v - 1, 0));
      const float* known_below = grid.inverse_variance.row(std::min(v + 1, last_v));
      float* edge = grid.edge.row(v);
      for (int u = 0; u <= last_u; ++u) {
        const int left = std::max(u - 1, 0);
        const int right = std::min(u + 1, last_u);
        const bool has_x = known[left] > 0 && known[right] > 0;
        const bool has_y = known_above[u] > 0 && known_below[u] > 0;
        const float gx = has_x ? (light[right] - light[left]) / 2 : 0;
        const float gy = has_y ? (below[u] - above[u]) / 2 : 0;
        edge[u] = 1 / (1 + (gx * gx + gy * gy) / (kEdge * kEdge));
      }
    }
  });
}

// As if every patch faced the camera: closed form for lights at the lens. Pixels without data get
// the mean of the others.
bool ShapeFromShading::start_coarsest() {
  ShapeGrid& grid = grids_.back();
  const double log_lights = std::log(static_cast<double>(lights_.x.size()));
  double sum = 0;
  int count = 0;
  for (int v = 0; v < grid.camera.height; ++v) {
    const double y = (v - grid.camera.cy) / grid.camera.fy;
    for (int u = 0; u < grid.camera.width; ++u) {
      if (grid.inverse_variance.row(v)[u] == 0) continue;
      const double x = (u - grid.camera.cx) / grid.camera.fx;
      const double obliqueness =
          (static_cast<double>(lights_.lobe) + 2.5) * 0.5 * std::log(1 + x * x + y * y);
      const double zeta =
          0.5 * (log_lights - obliqueness - static_cast<double>(grid.log_light.row(v)[u]));
      grid.zeta.row(v)[u] = static_cast<float>(zeta);
      sum += zeta;
      ++count;
    }
  }
  if (count < kLeastData * pixels(grid) || count == 0) return false;
  const auto mean = static_cast<float>(sum / count);
  for (int v = 0; v < grid.camera.height; ++v) {
    for (int u = 0; u < grid.camera.width; ++u) {
      if (grid.inverse_variance.row(v)[u] == 0) grid.zeta.row(v)[u] = mean;
    }
  }
  return true;
}

// Bilinear between the centres of the coarse pixels.
void ShapeFromShading::refine_from(const ShapeGrid& coarse, ShapeGrid& fine) const {
  constexpr float kNear = 0.75F;
  constexpr float kFar = 0.25F;
  for (int v = 0; v < fine.camera.height; ++v) {
    const int near_v = std::min(v / 2, coarse.camera.height - 1);
    const int far_v = std::clamp(v % 2 == 0 ? v / 2 - 1 : v / 2 + 1, 0, coarse.camera.height - 1);
    const float* near_row = coarse.zeta.row(near_v);
    const float* far_row = coarse.zeta.row(far_v);
    float* to = fine.zeta.row(v);
    for (int u = 0; u < fine.camera.width; ++u) {
      const int near_u = std::min(u / 2, coarse.camera.width - 1);
      const int far_u = std::clamp(u % 2 == 0 ? u / 2 - 1 : u / 2 + 1, 0, coarse.camera.width - 1);
      to[u] = kNear * (kNear * near_row[near_u] + kFar * near_row[far_u]) +
              kFar * (kNear * far_row[near_u] + kFar * far_row[far_u]);
    }
  }
}

ShapeWeights ShapeFromShading::weights() const {
  return {.cauchy = kCauchy,
          .smoothness = static_cast<float>(options_.curvature_radius),
          .damping = kDamping,
          .cosine_floor = kCosineFloor};
}

void ShapeFromShading::minimise(ShapeGrid& grid, int iterations, int inner_iterations) {
  const auto nearest = static_cast<float>(std::log(options_.min_depth));
  const auto farthest = static_cast<float>(std::log(options_.max_depth));
  for (int iteration = 0; iteration < iterations; ++iteration) {
    for_rows(grid, [&](int begin, int end) { linearise(grid, lights_, weights(), begin, end); });
    double rz =
        sum_rows(grid, [&](int begin, int end) { return assemble(grid, weights(), begin, end); });
    for (int inner = 0; inner < inner_iterations && rz > 0; ++inner) {
      const double curvature =
          sum_rows(grid, [&](int begin, int end) { return multiply(grid, begin, end); });
      if (!(curvature > 0)) break;
      const auto alpha = static_cast<float>(rz / curvature);
      const double next =
          sum_rows(grid, [&](int begin, int end) { return advance(grid, alpha, begin, end); });
      const auto beta = static_cast<float>(next / rz);
      rz = next;
      if (inner + 1 < inner_iterations) {
        for_rows(grid, [&](int begin, int end) { turn(grid, beta, begin, end); });
      }
    }
    for_rows(grid, [&](int begin, int end) {
      for (int v = begin; v < end; ++v) {
        float* zeta = grid.zeta.row(v);
        const float* step = grid.step.row(v);
        for (int u = 0; u < grid.camera.width; ++u) {
          zeta[u] = std::clamp(zeta[u] + std::clamp(step[u], -kLargestStep, kLargestStep), nearest,
                               farthest);
        }
      }
    });
  }
}

}  // namespace gastronaut::perception

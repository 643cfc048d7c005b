// One level of the pyramid that shape_from_shading solves on: planes of floats with a border of
// zeros, so that stencils and vectors run over the border without asking.
#pragma once

#include <cstddef>
#include <vector>

#include "camera/pinhole_grid.hpp"

namespace gastronaut::perception {

// Columns are handled this many at a time, and sums are taken in this many lanes, whatever the
// processor has: results do not depend on it.
inline constexpr int kShapeLanes = 16;

class BorderedPlane {
 public:
  BorderedPlane() = default;
  BorderedPlane(int width, int height)
      : stride_(padded(width) + 2 * kShapeLanes),
        values_(static_cast<std::size_t>(stride_) * static_cast<std::size_t>(height + 2 * kRows),
                0.0F) {}

  // `width` rounded up to whole vectors.
  static int padded(int width) { return (width + kShapeLanes - 1) / kShapeLanes * kShapeLanes; }

  int stride() const { return stride_; }
  // v from -2 to height + 1, columns from -16.
  float* row(int v) { return values_.data() + offset(v); }
  const float* row(int v) const { return values_.data() + offset(v); }
  void fill(float value) { values_.assign(values_.size(), value); }

 private:
  static constexpr int kRows = 2;  // the stencil's reach
  std::ptrdiff_t offset(int v) const {
    return static_cast<std::ptrdiff_t>(v + kRows) * stride_ + kShapeLanes;
  }
  int stride_ = 0;
  std::vector<float> values_;
};

struct ShapeGrid {
  explicit ShapeGrid(const PinholeGrid& grid);

  PinholeGrid camera;
  int padded_width;  // columns that the kernels handle
  // By column: ray, coefficients of the first difference (left, own, right) times fx, whether the
  // second difference and the mixed one exist (1 or 0).
  std::vector<float> ray_x, left, own, right, has_second, has_mixed;

  // Unknown and data: zeta = ln(depth / 1 m), ln of the light per unit albedo and LED power, its
  // inverse variance (0: no data), factor of the smoothness.
  BorderedPlane zeta, log_light, inverse_variance, edge;
  // Linearised data term: coefficients of a pixel's weighted residual (own, left, right, up, down)
  // and that residual; the residual itself; weights of the second differences, and these weighted.
  BorderedPlane own_c, left_c, right_c, up_c, down_c, weighted_residual, residual;
  BorderedPlane smooth_x, smooth_y, smooth_xy, second_x, second_y, second_xy;
  // Normal equations A step = gradient: A's half stencil, (dx, dy) in its name.
  BorderedPlane a00, a10, a20, a01, a02, a11, am11, inverse_diagonal;
  // Conjugate gradients.
  BorderedPlane step, direction, product, remainder, preconditioned;
};

}  // namespace gastronaut::perception

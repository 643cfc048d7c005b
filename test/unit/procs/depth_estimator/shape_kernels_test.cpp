#include "depth_estimator/shape_kernels.hpp"

#include <gtest/gtest.h>
#include <hwy/highway.h>

#include <algorithm>
#include <vector>

#include "unit/procs/depth_estimator/lit_surface.hpp"

namespace gastronaut::perception {
namespace {

const PinholeGrid kGrid{40, 30, 20.8, 21.2, 20.1, 14.6};
const LightsConfiguration kLights;
const ShapeWeights kNotRobust{
    .cauchy = 1e4F, .smoothness = 0.001F, .damping = 1e-3F, .cosine_floor = 0.05F};

ShapeLights lights() {
  ShapeLights result;
  for (int k = 0; k < kLights.count; ++k) {
    const double angle = 2 * std::numbers::pi * k / kLights.count + kLights.phase;
    result.x.push_back(static_cast<float>(kLights.radius * std::cos(angle)));
    result.y.push_back(static_cast<float>(kLights.radius * std::sin(angle)));
  }
  result.lobe = static_cast<float>(kLights.lobe);
  return result;
}

// A bent wall and what it is lit like, in a grid ready for the kernels.
ShapeGrid bent_wall() {
  ShapeGrid grid(kGrid);
  const LitSurface lit = light_surface(kGrid, kLights, sphere({0.005, 0, 0.01}, 0.03), 1);
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      grid.zeta.row(v)[u] = std::log(lit.depth.at(u, v));
      grid.log_light.row(v)[u] = lit.shading.log_light.at(u, v);
      grid.inverse_variance.row(v)[u] = 1;
      grid.edge.row(v)[u] = 1;
    }
  }
  return grid;
}

TEST(ShapeKernels, TrueShapeLeavesNoResidual) {
  ShapeGrid grid = bent_wall();
  linearise(grid, lights(), kNotRobust, 0, kGrid.height);
  // Slopes are first differences over two coarse pixels: second-order small on a sphere.
  constexpr float kDifferenceError = 0.02F;
  for (int v = 1; v + 1 < kGrid.height; ++v) {
    for (int u = 1; u + 1 < kGrid.width; ++u) {
      EXPECT_NEAR(grid.residual.row(v)[u], 0, kDifferenceError) << u << ", " << v;
    }
  }
}

TEST(ShapeKernels, DerivativesAreThoseOfTheResidual) {
  // Central differences in single precision: rounding of the logarithm over the step.
  constexpr float kStep = 4e-4F;
  constexpr float kTolerance = 5e-3F;
  ShapeGrid grid = bent_wall();
  linearise(grid, lights(), kNotRobust, 0, kGrid.height);
  const ShapeGrid at = grid;
  for (const auto& [u, v] : {std::pair{0, 0}, {20, 15}, {39, 29}, {7, 0}, {0, 11}, {33, 22}}) {
    const auto slope = [&, u = u, v = v](int du, int dv) {
      float difference = 0;
      for (const float sign : {1.0F, -1.0F}) {
        ShapeGrid moved = bent_wall();
        moved.zeta.row(v + dv)[u + du] += sign * kStep;
        linearise(moved, lights(), kNotRobust, 0, kGrid.height);
        difference -= sign * moved.residual.row(v)[u];
      }
      return difference / (2 * kStep);
    };
    const auto scale = [](float value) { return kTolerance * std::max(1.0F, std::abs(value)); };
    const float own = at.own_c.row(v)[u];
    EXPECT_NEAR(own, slope(0, 0), scale(own)) << u << ", " << v;
    if (u > 0) {
      EXPECT_NEAR(at.left_c.row(v)[u], slope(-1, 0), scale(own));
    }
    if (u + 1 < kGrid.width) {
      EXPECT_NEAR(at.right_c.row(v)[u], slope(1, 0), scale(own));
    }
    if (v > 0) {
      EXPECT_NEAR(at.up_c.row(v)[u], slope(0, -1), scale(own));
    }
    if (v + 1 < kGrid.height) {
      EXPECT_NEAR(at.down_c.row(v)[u], slope(0, 1), scale(own));
    }
  }
}

TEST(ShapeKernels, MatrixIsTheSquareOfItsRows) {
  ShapeGrid grid = bent_wall();
  for (int v = 0; v < kGrid.height; ++v) grid.edge.row(v)[(7 * v) % kGrid.width] = 0.2F;
  linearise(grid, lights(), kNotRobust, 0, kGrid.height);
  assemble(grid, kNotRobust, 0, kGrid.height);
  // x^T A x = |J x|^2 + damping |x|^2 for any x, J's rows written out.
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      grid.direction.row(v)[u] =
          std::sin(0.9F * static_cast<float>(u) - 0.7F * static_cast<float>(v));
    }
  }
  const double quadratic = multiply(grid, 0, kGrid.height);
  double expected = 0;
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      const auto x = [&](int du, int dv) {
        return static_cast<double>(grid.direction.row(v + dv)[u + du]);
      };
      const auto add = [&](float weight, double row) {
        expected += static_cast<double>(weight) * row * row;
      };
      add(1, static_cast<double>(grid.own_c.row(v)[u]) * x(0, 0) +
                 static_cast<double>(grid.left_c.row(v)[u]) * x(-1, 0) +
                 static_cast<double>(grid.right_c.row(v)[u]) * x(1, 0) +
                 static_cast<double>(grid.up_c.row(v)[u]) * x(0, -1) +
                 static_cast<double>(grid.down_c.row(v)[u]) * x(0, 1));
      add(grid.smooth_x.row(v)[u], x(-1, 0) - 2 * x(0, 0) + x(1, 0));
      add(grid.smooth_y.row(v)[u], x(0, -1) - 2 * x(0, 0) + x(0, 1));
      add(grid.smooth_xy.row(v)[u], x(0, 0) - x(1, 0) - x(0, 1) + x(1, 1));
      add(kNotRobust.damping, x(0, 0));
    }
  }
  constexpr double kSinglePrecision = 1e-5;
  EXPECT_NEAR(quadratic / expected, 1, kSinglePrecision);
}

TEST(ShapeKernels, SameBytesOnEveryInstructionSet) {
  std::vector<float> first;
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    ShapeGrid grid = bent_wall();
    linearise(grid, lights(), kNotRobust, 0, kGrid.height);
    const double rz = assemble(grid, kNotRobust, 0, kGrid.height);
    const double curvature = multiply(grid, 0, kGrid.height);
    const double next = advance(grid, static_cast<float>(rz / curvature), 0, kGrid.height);
    turn(grid, static_cast<float>(next / rz), 0, kGrid.height);
    std::vector<float> result;
    for (int v = 0; v < kGrid.height; ++v) {
      for (const BorderedPlane* plane : {&grid.residual, &grid.direction, &grid.step}) {
        result.insert(result.end(), plane->row(v), plane->row(v) + kGrid.width);
      }
    }
    if (first.empty()) first = result;
    EXPECT_EQ(result, first) << hwy::TargetName(target);
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

}  // namespace
}  // namespace gastronaut::perception

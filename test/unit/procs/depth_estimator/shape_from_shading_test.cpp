#include "depth_estimator/shape_from_shading.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"
#include "unit/procs/depth_estimator/lit_surface.hpp"

namespace gastronaut::perception {
namespace {

const PinholeGrid kGrid{160, 120, 83.2, 83.2, 80.4, 58.4};
const DepthEstimatorConfiguration kOptions;
const LightsConfiguration kLights;
const NearLight kNearLight{CameraConfiguration(), kLights};
// What smoothness, which would have curved walls flat, and a fixed number of steps leave on noise-
// free data: under 2 % of the depth, half of what the albedo's usual variation costs.
constexpr double kSolverError = 0.02;

// Relative error over all pixels: mean absolute, mean.
struct RelativeErrors {
  double mean = 0;
  double bias = 0;
};
RelativeErrors compare(const Plane<float>& depth, const Plane<float>& truth) {
  RelativeErrors errors;
  for (std::size_t i = 0; i < depth.size(); ++i) {
    const double error =
        static_cast<double>(depth.values[i]) / static_cast<double>(truth.values[i]) - 1;
    errors.mean += std::abs(error) / static_cast<double>(depth.size());
    errors.bias += error / static_cast<double>(depth.size());
  }
  return errors;
}

Shape solve(const LitSurface& lit) {
  return ShapeFromShading(lit.grid, kNearLight, kOptions).solve(lit.shading).value();
}

class KnownSurface : public testing::TestWithParam<std::pair<const char*, Surface>> {};

TEST_P(KnownSurface, IsFoundAtItsMetricDepth) {
  const LitSurface lit = light_surface(kGrid, kLights, GetParam().second, kOptions.data_std);
  EXPECT_LT(compare(solve(lit).depth, lit.depth).mean, kSolverError);
}

INSTANTIATE_TEST_SUITE_P(
    ShapeFromShading, KnownSurface,
    testing::Values(std::pair{"WallAhead", plane_through({0, 0, 0.04}, {0, 0, -1})},
                    // So near that the lights are as far from the lens as the wall is.
                    std::pair{"WallAt8Millimetres", plane_through({0, 0, 0.008}, {0, 0, -1})},
                    std::pair{"SlantedWall", plane_through({0, 0, 0.04}, {0.4, 0.2, -1})},
                    std::pair{"InsideOfASphere", sphere({0.005, 0, 0.015}, 0.035)},
                    std::pair{"BallAhead", sphere({0, 0, 0.3}, 0.26)}),
    [](const auto& known) { return std::string(known.param.first); });

TEST(ShapeFromShading, FourTimesTheLightIsAboutHalfTheDistance) {
  LitSurface lit =
      light_surface(kGrid, kLights, plane_through({0, 0, 0.06}, {0, 0, -1}), kOptions.data_std);
  for (float& light : lit.shading.log_light.values) light += std::log(4.0F);
  const Shape shape = solve(lit);
  // The lights' distance from the lens, 3 mm to 30 mm squared, is what it is not quite half.
  constexpr double kLightsBesideTheLens = 0.01;
  EXPECT_NEAR(static_cast<double>(shape.depth.at(80, 60)), 0.03,
              (kSolverError + kLightsBesideTheLens) * 0.03);
}

TEST(ShapeFromShading, NoiseOfTheDataDoesNotShiftTheScale) {
  LitSurface lit = light_surface(kGrid, kLights, sphere({0.005, 0, 0.015}, 0.035), 0.05);
  const CounterRandom random(7, 0);
  for (std::size_t i = 0; i < lit.shading.log_light.size(); ++i) {
    lit.shading.log_light.values[i] += 0.05F * static_cast<float>(random.normal(i));
  }
  EXPECT_LT(std::abs(compare(solve(lit).depth, lit.depth).bias), kSolverError);
}

TEST(ShapeFromShading, HoleInTheDataIsBridged) {
  LitSurface lit = light_surface(kGrid, kLights, plane_through({0, 0, 0.04}, {0.3, 0, -1}), 0.05);
  for (int v = 50; v < 66; ++v) {
    for (int u = 70; u < 90; ++u) {
      lit.shading.inverse_variance.at(u, v) = 0;
      lit.shading.log_light.at(u, v) = 0;
    }
  }
  const Shape shape = solve(lit);
  EXPECT_NEAR(shape.depth.at(80, 58), lit.depth.at(80, 58), 2 * kSolverError * 0.04);
}

TEST(ShapeFromShading, WrongPixelsDoNotBendTheWall) {
  LitSurface lit = light_surface(kGrid, kLights, plane_through({0, 0, 0.04}, {0, 0, -1}), 0.05);
  const CounterRandom random(3, 0);
  for (std::size_t i = 0; i < lit.shading.log_light.size(); ++i) {
    if (random.uniform(i) < 0.03)
      lit.shading.log_light.values[i] += 2;  // specks, 7 times as bright
  }
  EXPECT_LT(compare(solve(lit).depth, lit.depth).mean, 2 * kSolverError);
}

TEST(ShapeFromShading, PatchTexturePassesIntoTheUnexplainedPart) {
  LitSurface lit = light_surface(kGrid, kLights, plane_through({0, 0, 0.04}, {0, 0, -1}), 0.05);
  constexpr float kDarkening = 0.3F;
  for (int v = 0; v < kGrid.height; ++v) lit.shading.log_light.at(80, v) -= kDarkening;  // a vessel
  const Shape shape = solve(lit);
  const float unexplained = lit.shading.log_light.at(80, 60) - shape.log_shading.at(80, 60);
  constexpr float kMostOfIt = 0.5F;
  EXPECT_LT(unexplained, -kMostOfIt * kDarkening);
  EXPECT_LT(compare(shape.depth, lit.depth).mean, 2 * kSolverError);
}

TEST(ShapeFromShading, ScaleIsThisPicturesOwnWhateverTheLastOneWas) {
  const auto wall = [](double distance) {
    return light_surface(kGrid, kLights, plane_through({0, 0, distance}, {0.2, 0, -1}), 0.05);
  };
  for (const double ratio : {0.25, 0.7, 0.8, 0.9, 1.1, 1.3, 4.0}) {
    ShapeFromShading solver(kGrid, kNearLight, kOptions);
    ASSERT_TRUE(solver.solve(wall(ratio * 0.03).shading));
    solver.remember();
    const LitSurface now = wall(0.03);
    // A fresh solver is off by a hundredth of this.
    EXPECT_LT(compare(solver.solve(now.shading)->depth, now.depth).mean, 0.5 * kSolverError)
        << ratio;
  }
}

TEST(ShapeFromShading, ShadingIsThatOfTheDepthThatIsGiven) {
  const PinholeGrid grid{320, 240, 166.4, 166.4, 160.8, 116.8};
  const LitSurface lit = light_surface(grid, kLights, sphere({0.005, 0, 0.015}, 0.035), 0.05);
  const Shape shape = ShapeFromShading(grid, kNearLight, kOptions).solve(lit.shading).value();
  ShapeGrid check(grid);
  for (int v = 0; v < grid.height; ++v) {
    for (int u = 0; u < grid.width; ++u) check.zeta.row(v)[u] = std::log(shape.depth.at(u, v));
  }
  ShapeLights lights;
  for (const Eigen::Vector3d& position : kNearLight.positions()) {
    lights.x.push_back(static_cast<float>(position.x()));
    lights.y.push_back(static_cast<float>(position.y()));
  }
  lights.lobe = static_cast<float>(kLights.lobe);
  linearise(check, lights, {.cauchy = 1, .cosine_floor = 0.1F}, 0, grid.height);
  // ln light is zero here, so the residual is minus the model's. The depth went through exp and
  // log; slopes are its differences times the focal length.
  constexpr float kRounding = 2e-4F;
  for (int v = 0; v < grid.height; v += 7) {
    for (int u = 0; u < grid.width; u += 7) {
      EXPECT_NEAR(-check.residual.row(v)[u], shape.log_shading.at(u, v), kRounding)
          << u << ", " << v;
    }
  }
}

TEST(ShapeFromShading, DarknessHasNoShape) {
  Shading shading{Plane<float>(160, 120), Plane<float>(160, 120)};
  EXPECT_FALSE(ShapeFromShading(kGrid, kNearLight, kOptions).solve(shading));
  shading.inverse_variance.at(3, 3) = 400;  // one pixel is no picture
  EXPECT_FALSE(ShapeFromShading(kGrid, kNearLight, kOptions).solve(shading));
}

TEST(ShapeFromShading, SmallAndOddPicturesWork) {
  for (const auto& [width, height] : {std::pair{1, 1}, {2, 3}, {31, 17}, {125, 61}}) {
    const PinholeGrid grid{width, height, 60, 60, width / 2.0, height / 2.0};
    const LitSurface lit =
        light_surface(grid, kLights, plane_through({0, 0, 0.03}, {0, 0, -1}), 0.05);
    EXPECT_LT(compare(solve(lit).depth, lit.depth).mean, 2 * kSolverError)
        << width << " x " << height;
  }
}

TEST(ShapeFromShading, SameBytesOnOneThreadAndMany) {
  const PinholeGrid grid{320, 240, 166.4, 166.4, 160.8, 116.8};
  const LitSurface lit = light_surface(grid, kLights, sphere({0.005, 0, 0.015}, 0.035), 0.05);
  set_thread_count(1);
  const Shape one = solve(lit);
  set_thread_count(4);
  const Shape many = solve(lit);
  set_thread_count(0);
  EXPECT_EQ(one.depth.values, many.depth.values);
  EXPECT_EQ(one.log_shading.values, many.log_shading.values);
}

}  // namespace
}  // namespace gastronaut::perception

#include "calibrate/light_model.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "photometry/near_light.hpp"

namespace gastronaut {
namespace {

constexpr double kStep = 1e-6;           // relative, of central differences
constexpr double kOfDifferences = 1e-6;  // relative error of such a derivative
constexpr double kRounding = 1e-12;

const std::vector<double> kTable = {0, 0.03, 0.1, 0.25, 0.55, 1};

TEST(ResponseCurve, LevelAndLightAreInverse) {
  for (const ResponseCurve& curve :
       {ResponseCurve::with_gamma(2.2), ResponseCurve::with_table(kTable)}) {
    for (const double level : {0.01, 0.2, 0.35, 0.6, 0.999}) {
      EXPECT_NEAR(curve.level(curve.light(level)).level, level, kRounding);
    }
  }
}

TEST(ResponseCurve, TableKeepsItsValuesAndStaysMonotoneForAnyParameters) {
  ResponseCurve curve = ResponseCurve::with_table(kTable);
  for (std::size_t k = 0; k < kTable.size(); ++k)
    EXPECT_NEAR(curve.table()[k], kTable[k], kRounding);
  Eigen::VectorXd wild(5);
  wild << 3, -8, 0, 12, -1;
  curve.set_parameters(wild);
  const std::vector<double> table = curve.table();
  EXPECT_EQ(table.front(), 0);
  EXPECT_EQ(table.back(), 1);
  for (std::size_t k = 1; k < table.size(); ++k) EXPECT_GT(table[k], table[k - 1]);
}

TEST(ResponseCurve, DerivativesAreThoseOfDifferences) {
  for (ResponseCurve curve : {ResponseCurve::with_gamma(1.7), ResponseCurve::with_table(kTable)}) {
    for (const double light : {0.02, 0.3, 0.8}) {
      Eigen::VectorXd by_parameters(curve.num_parameters());
      const auto level = curve.level(light, by_parameters.data());
      const double step = kStep * light;
      EXPECT_NEAR(level.slope,
                  (curve.level(light + step).level - curve.level(light - step).level) / (2 * step),
                  kOfDifferences * level.slope);
      const Eigen::VectorXd parameters = curve.parameters();
      for (Eigen::Index i = 0; i < parameters.size(); ++i) {
        const Eigen::VectorXd change = kStep * Eigen::VectorXd::Unit(parameters.size(), i);
        ResponseCurve up = curve;
        ResponseCurve down = curve;
        up.set_parameters(parameters + change);
        down.set_parameters(parameters - change);
        EXPECT_NEAR(by_parameters(i),
                    (up.level(light).level - down.level(light).level) / (2 * kStep),
                    kOfDifferences);
      }
    }
  }
}

TEST(Shading, IsWhatNearLightSendsToAPatchOfUnitAlbedo) {
  CameraConfiguration camera;
  LightsConfiguration lights;
  lights.lobe = 1.7;
  const NearLight light(camera, lights);
  const Eigen::Vector3d ray(0.4, -0.3, 1);
  const Eigen::Vector3d plane(12, -7, 80);  // about 12 mm away
  const Eigen::Vector3d point = ray / plane.dot(ray);
  const double expected = -plane.normalized().dot(light.irradiance_vector(point));
  const Shading shading = shade(ray, plane, light.positions(), lights.lobe);
  ASSERT_TRUE(shading.lit);
  EXPECT_NEAR(camera.led_intensity * std::exp(shading.log_light), expected, kRounding * expected);
}

TEST(Shading, DerivativesAreThoseOfDifferences) {
  const std::vector<Eigen::Vector3d> lights = NearLight({}, {}).positions();
  const Eigen::Vector3d ray(0.4, -0.3, 1);
  const Eigen::Vector3d plane(12, -7, 80);
  const double lobe = 1.3;
  const Shading shading = shade(ray, plane, lights, lobe);
  EXPECT_NEAR(shading.by_lobe,
              (shade(ray, plane, lights, lobe + kStep).log_light -
               shade(ray, plane, lights, lobe - kStep).log_light) /
                  (2 * kStep),
              kOfDifferences);
  for (Eigen::Index i = 0; i < 3; ++i) {
    const double step = kStep * plane.norm();
    const Eigen::Vector3d change = step * Eigen::Vector3d::Unit(i);
    EXPECT_NEAR(shading.by_plane(i),
                (shade(ray, plane + change, lights, lobe).log_light -
                 shade(ray, plane - change, lights, lobe).log_light) /
                    (2 * step),
                kOfDifferences);
  }
}

TEST(Shading, WhatIsBehindTheLensOrTurnedAwayIsNotLit) {
  const std::vector<Eigen::Vector3d> lights = NearLight({}, {}).positions();
  EXPECT_FALSE(shade({0, 0, 1}, {0, 0, -50}, lights, 1).lit);
  // A wall beside the lens that passes between the lights: some of them shine on its back.
  EXPECT_FALSE(shade({1, 0, 1}, {500, 0, 1}, lights, 1).lit);
}

}  // namespace
}  // namespace gastronaut

#include "photometry/near_light.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace gastronaut {
namespace {

constexpr double kRounding = 1e-12;  // relative

LightsConfiguration one_light_in_the_lens() {
  LightsConfiguration lights;
  lights.count = 1;
  lights.radius = 0;
  return lights;
}

TEST(NearLight, FallsWithTheSquareOfTheDistance) {
  const CameraConfiguration camera;
  const NearLight light(camera, one_light_in_the_lens());
  const Eigen::Vector3d towards_lens(0, 0, -1);
  for (const double distance : {0.005, 0.01, 0.04}) {
    EXPECT_NEAR(towards_lens.dot(light.irradiance_vector({0, 0, distance})),
                camera.led_intensity / (distance * distance),
                kRounding * camera.led_intensity / (distance * distance));
  }
}

TEST(NearLight, ShinesToTheSideWithThePowerOfTheCosine) {
  const CameraConfiguration camera;
  LightsConfiguration lights = one_light_in_the_lens();
  lights.lobe = 2.5;
  const NearLight light(camera, lights);
  // 60 degrees off the axis, 20 mm from the light, the patch facing it.
  const double angle = std::numbers::pi / 3;
  const Eigen::Vector3d way(std::sin(angle), 0, std::cos(angle));
  EXPECT_NEAR(-way.dot(light.irradiance_vector(0.02 * way)),
              camera.led_intensity * std::pow(0.5, 2.5) / (0.02 * 0.02), kRounding * 1e2);
}

TEST(NearLight, LightsSitOnTheirCircleCountedFromXTowardsY) {
  LightsConfiguration lights;
  lights.count = 4;
  lights.radius = 0.003;
  lights.phase = std::numbers::pi / 2;
  const auto positions = NearLight(CameraConfiguration(), lights).positions();
  ASSERT_EQ(positions.size(), 4U);
  EXPECT_NEAR((positions[0] - Eigen::Vector3d(0, 0.003, 0)).norm(), 0, kRounding);
  EXPECT_NEAR((positions[1] - Eigen::Vector3d(-0.003, 0, 0)).norm(), 0, kRounding);
}

TEST(NearLight, SeveralLightsAddUpAndEachKeepsItsPower) {
  const CameraConfiguration camera;
  LightsConfiguration lights;
  lights.count = 6;
  lights.radius = 0.003;
  // On the axis all six are equally far, and their sideways parts cancel.
  const double depth = 0.01;
  const double distance = std::hypot(depth, lights.radius);
  const double cosine = depth / distance;
  const Eigen::Vector3d sum = NearLight(camera, lights).irradiance_vector({0, 0, depth});
  const double expected =
      6 * camera.led_intensity * std::pow(cosine, lights.lobe + 1) / (distance * distance);
  EXPECT_NEAR(-sum.z(), expected, kRounding * expected);
  EXPECT_NEAR(sum.head<2>().norm(), 0, kRounding * expected);
}

TEST(NearLight, WhatLiesAtOrBehindTheLensPlaneGetsNoLight) {
  const NearLight light{CameraConfiguration(), LightsConfiguration()};
  EXPECT_TRUE(light.irradiance_vector({0.01, 0, 0}).isZero());
  EXPECT_TRUE(light.irradiance_vector({0, 0, -0.01}).isZero());
}

TEST(NearLight, VignettingIsAPowerOfTheRaysCosineWhateverItsLength) {
  CameraConfiguration camera;
  camera.vignetting_cos_power = 3;
  const NearLight light(camera, LightsConfiguration());
  EXPECT_EQ(light.vignetting({0, 0, 0.02}), 1);
  EXPECT_NEAR(light.vignetting({1, 0, 1}), std::pow(0.5, 1.5), kRounding);
  EXPECT_NEAR(light.vignetting({7, 0, 7}), std::pow(0.5, 1.5), kRounding);
}

}  // namespace
}  // namespace gastronaut

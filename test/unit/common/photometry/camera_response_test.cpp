#include "photometry/camera_response.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace gastronaut {
namespace {

constexpr double kFloat = 1e-6;  // relative, of single precision

TEST(CameraResponse, GammaIsThePowerLawOfTheConfigurationsEquation) {
  CameraConfiguration camera;
  camera.gamma = 1.8;
  const auto light = linear_light_of_levels(camera);
  EXPECT_EQ(light.front(), 0.0F);
  EXPECT_EQ(light.back(), 1.0F);
  // pixel = 255 L^(1/gamma), turned round.
  for (const std::size_t level : {1U, 50U, 128U, 254U}) {
    const double back = 255 * std::pow(static_cast<double>(light[level]), 1 / camera.gamma);
    EXPECT_NEAR(back, static_cast<double>(level), kFloat * 255);
  }
}

TEST(CameraResponse, TableIsStraightBetweenItsLevelsAndTakesPrecedenceOverGamma) {
  CameraConfiguration camera;
  camera.response = {0, 0.1, 0.4, 1};  // at levels 0, 85, 170, 255
  const auto light = linear_light_of_levels(camera);
  EXPECT_FLOAT_EQ(light[0], 0.0F);
  EXPECT_FLOAT_EQ(light[85], 0.1F);
  EXPECT_FLOAT_EQ(light[170], 0.4F);
  EXPECT_FLOAT_EQ(light[255], 1.0F);
  EXPECT_FLOAT_EQ(light[17], 0.02F);   // a fifth of the way to 0.1
  EXPECT_FLOAT_EQ(light[187], 0.52F);  // a fifth of the way from 0.4 to 1
}

TEST(CameraResponse, GrowsStrictlyWhateverItComesFrom) {
  CameraConfiguration by_gamma;
  CameraConfiguration by_table;
  by_table.response = {0, 1e-4, 0.9, 1};
  for (const CameraConfiguration& camera : {by_gamma, by_table}) {
    const auto light = linear_light_of_levels(camera);
    for (std::size_t level = 1; level < light.size(); ++level) {
      EXPECT_GT(light[level], light[level - 1]) << level;
    }
  }
}

}  // namespace
}  // namespace gastronaut

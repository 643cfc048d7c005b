#include "virtual_rig/gradient_noise.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace gastronaut {
namespace {

Eigen::Vector3f place(int i) {
  const auto n = static_cast<float>(i);
  return {0.731F * n - 40, 0.417F * n - 55, 30 - 0.593F * n};
}

TEST(GradientNoise, GradientMatchesFiniteDifference) {
  constexpr float kStep = 1e-3F;
  constexpr float kSecondOrder = 5e-3F;  // and what single precision leaves of small differences
  for (int i = 0; i < 200; ++i) {
    const NoiseSample sample = gradient_noise(place(i), 5);
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3f step = kStep * Eigen::Vector3f::Unit(axis);
      const float slope =
          (gradient_noise(place(i) + step, 5).value - gradient_noise(place(i) - step, 5).value) /
          (2 * kStep);
      EXPECT_NEAR(sample.gradient[axis], slope, kSecondOrder);
    }
  }
}

TEST(GradientNoise, HasMeanZeroAndTheStatedSpread) {
  constexpr int kSamples = 20000;
  double sum = 0;
  double squares = 0;
  for (int i = 0; i < kSamples; ++i) {
    const auto value = static_cast<double>(gradient_noise(place(i), 9).value);
    sum += value;
    squares += value * value;
  }
  constexpr double kSampling = 0.02;  // neighbours are correlated
  EXPECT_NEAR(sum / kSamples, 0, kSampling);
  EXPECT_NEAR(std::sqrt(squares / kSamples), 0.27, kSampling);
}

TEST(GradientNoise, SeedsDiffer) {
  EXPECT_NE(gradient_noise({0.3F, 0.4F, 0.5F}, 1).value,
            gradient_noise({0.3F, 0.4F, 0.5F}, 2).value);
}

}  // namespace
}  // namespace gastronaut

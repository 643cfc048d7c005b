#include "evaluate/depth_errors.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace gastronaut::evaluation {
namespace {

constexpr double kSinglePrecision = 1e-6;  // relative, of depths kept as float

// A wall that leans: depth = offset + slope * x / z along the ray.
DepthPicture leaning_wall(int width, int height, double focal_length, double offset, double slope) {
  DepthPicture picture{
      width, height, focal_length, focal_length, (width - 1) / 2.0, (height - 1) / 2.0, {}};
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      picture.depth.push_back(static_cast<float>(offset + slope * (u - picture.cx) / focal_length));
    }
  }
  return picture;
}

TEST(CompareDepthTest, AConstantErrorShowsInEveryFigure) {
  const DepthPicture truth = leaning_wall(40, 30, 30, 0.04, 0);
  const DepthPicture estimate = leaning_wall(40, 30, 30, 0.042, 0);
  DepthProfile profile;
  const DepthErrors errors = compare_depth(estimate, truth, profile);
  EXPECT_EQ(errors.truth_pixels, 1200U);
  EXPECT_NEAR(errors.compared.mean_absolute(), 0.002, kSinglePrecision);
  EXPECT_NEAR(errors.compared.rmse(), 0.002, kSinglePrecision);
  EXPECT_NEAR(errors.compared.mean_relative(), 0.05, kSinglePrecision);
  EXPECT_NEAR(errors.compared.bias(), 0.002, kSinglePrecision);
  EXPECT_NEAR(errors.scale, 0.04 / 0.042, kSinglePrecision);
  EXPECT_NEAR(errors.mean_absolute_scaled(), 0, kSinglePrecision);
  EXPECT_EQ(errors.coverage(), 1);
}

TEST(CompareDepthTest, PixelsAreComparedAlongTheirRaysWhateverTheSizes) {
  const DepthPicture truth = leaning_wall(80, 60, 60, 0.04, 0.01);
  const DepthPicture estimate = leaning_wall(40, 30, 30, 0.04, 0.01);
  DepthProfile profile;
  const DepthErrors errors = compare_depth(estimate, truth, profile);
  // Half a pixel of the coarser picture at most between the rays.
  const double half_pixel = 0.5 * 0.01 / 30;
  EXPECT_LT(errors.compared.rmse(), half_pixel);
  EXPECT_GT(errors.coverage(), 0.99);
}

TEST(CompareDepthTest, ASmallerViewCoversLess) {
  const DepthPicture truth = leaning_wall(80, 60, 60, 0.04, 0);
  const DepthPicture middle = leaning_wall(40, 60, 60, 0.04, 0);
  DepthProfile profile;
  EXPECT_NEAR(compare_depth(middle, truth, profile).coverage(), 0.5, 1e-12);
}

TEST(CompareDepthTest, PixelsWithoutDepthAreNotCompared) {
  DepthPicture truth = leaning_wall(10, 10, 10, 0.04, 0);
  DepthPicture estimate = truth;
  truth.depth[0] = 0;
  estimate.depth[0] = 1;
  estimate.depth[1] = 0;
  DepthProfile profile;
  const DepthErrors errors = compare_depth(estimate, truth, profile);
  EXPECT_EQ(errors.truth_pixels, 99U);
  EXPECT_EQ(errors.compared.count, 98U);
  EXPECT_EQ(errors.compared.sum_absolute, 0);
}

TEST(CompareDepthTest, AnEmptyEstimateCoversNothing) {
  const DepthPicture truth = leaning_wall(10, 10, 10, 0.04, 0);
  DepthPicture estimate = truth;
  estimate.depth.assign(estimate.depth.size(), 0);
  DepthProfile profile;
  const DepthErrors errors = compare_depth(estimate, truth, profile);
  EXPECT_EQ(errors.coverage(), 0);
  EXPECT_TRUE(std::isnan(errors.compared.mean_absolute()));
}

TEST(CompareDepthTest, AnHonestSigmaGivesNormalisedErrorsOfOne) {
  const DepthPicture truth = leaning_wall(10, 10, 10, 0.04, 0);
  DepthPicture estimate = leaning_wall(10, 10, 10, 0.042, 0);
  DepthProfile profile;
  DepthErrors total = compare_depth(estimate, truth, profile);
  EXPECT_EQ(total.normalised_pixels, 0U);  // without sigma there is nothing to compare with
  estimate.relative_std = 0.002 / 0.042;
  total += compare_depth(estimate, truth, profile);
  EXPECT_EQ(total.normalised_pixels, 100U);
  constexpr double kSinglePrecisionOfErrors = 1e-5;  // errors are a twentieth of the depths
  EXPECT_NEAR(total.normalised_error(), 1, kSinglePrecisionOfErrors);
}

// Two walls, each with its own error: every figure of a band is of its wall alone.
TEST(DepthProfileTest, BandsHoldTheErrorsOfTheirDistances) {
  DepthPicture truth = leaning_wall(20, 10, 10, 0.011, 0);
  DepthPicture estimate = leaning_wall(20, 10, 10, 0.010, 0);
  for (std::size_t i = 0; i < 100; ++i) {
    truth.depth[i] = 0.04F;
    estimate.depth[i] = i < 25 ? 0.0F : 0.042F;
  }
  DepthProfile profile;
  compare_depth(estimate, truth, profile);
  const DepthProfile::Bin near = profile.between(0.005, 0.015);
  EXPECT_EQ(near.compared.count, 100U);
  EXPECT_NEAR(near.compared.bias(), -0.001, kSinglePrecision);
  EXPECT_NEAR(near.compared.mean_absolute(), 0.001, kSinglePrecision);
  EXPECT_NEAR(near.compared.mean_relative(), 1.0 / 11, kSinglePrecision);
  const DepthProfile::Bin far = profile.between(0.030, 0.045);
  EXPECT_EQ(far.truth_pixels, 100U);
  EXPECT_EQ(far.compared.count, 75U);
  EXPECT_NEAR(far.compared.rmse(), 0.002, kSinglePrecision);
  EXPECT_NEAR(far.compared.bias(), 0.002, kSinglePrecision);
  EXPECT_EQ(profile.between(0.015, 0.030).truth_pixels, 0U);
}

TEST(DepthProfileTest, WhatIsBeyondTheBinsCountsAsFar) {
  const DepthPicture wall = leaning_wall(10, 10, 10, 3.0, 0);
  DepthProfile profile;
  compare_depth(wall, wall, profile);
  EXPECT_EQ(profile.between(0.07, std::numeric_limits<double>::infinity()).compared.count, 100U);
}

}  // namespace
}  // namespace gastronaut::evaluation

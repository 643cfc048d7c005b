#include "visual_slam/surfel_view.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "surfel_scene.hpp"

namespace gastronaut::slam {
namespace {

constexpr int kU = 40;  // a pixel near the middle
constexpr int kV = 30;

void add(SurfelArrays& s, int u, int v, double depth, const Eigen::Vector3d& normal,
         double radius) {
  const std::size_t k = s.size();
  s.resize(k + 1);
  s.x[k] = static_cast<float>(depth * (u - kSceneGrid.cx) / kSceneGrid.fx);
  s.y[k] = static_cast<float>(depth * (v - kSceneGrid.cy) / kSceneGrid.fy);
  s.z[k] = static_cast<float>(depth);
  s.nx[k] = static_cast<float>(normal.x());
  s.ny[k] = static_cast<float>(normal.y());
  s.nz[k] = static_cast<float>(normal.z());
  s.radius[k] = static_cast<float>(radius);
  s.albedo[k] = 0.1F * static_cast<float>(k + 1);
  s.confidence[k] = static_cast<float>(k + 1);
}

ModelView view_of(const SurfelArrays& surfels, std::vector<std::int32_t> ids = {},
                  double farthest = 1) {
  if (ids.empty()) {
    ids.resize(surfels.size());
    std::iota(ids.begin(), ids.end(), 0);
  }
  SplatOptions options;
  options.farthest = farthest;
  ModelView view;
  view.grid = kSceneGrid;
  splat(surfels, {ids}, options, view);
  return view;
}

int pixels_seen(const ModelView& view) {
  return static_cast<int>(std::count_if(view.surfel.values.begin(), view.surfel.values.end(),
                                        [](std::int32_t id) { return id >= 0; }));
}

TEST(SurfelView, DiscCoversTheEllipseThatItsTiltMakes) {
  constexpr double kDepth = 0.05;
  constexpr double kRadius = 0.01;  // 9.6 pixels
  constexpr double kPi = 3.14159265358979;
  for (const double tilt : {0.0, 0.5, 1.0}) {
    SurfelArrays surfels;
    add(surfels, kU, kV, kDepth, {std::sin(tilt), 0, -std::cos(tilt)}, kRadius);
    const ModelView view = view_of(surfels);
    const double pixels = kRadius * kSceneGrid.fx / kDepth;
    // Counting the pixels of a figure errs by less than half its outline; tilt's perspective by
    // (radius sin(tilt) / depth)^2.
    const double area = kPi * pixels * pixels * std::cos(tilt);
    const double perspective = std::pow(kRadius * std::sin(tilt) / kDepth, 2);
    EXPECT_NEAR(pixels_seen(view), area, kPi * pixels + 1.5 * perspective * area) << tilt;
    EXPECT_FLOAT_EQ(view.depth.at(kU, kV), static_cast<float>(kDepth));
    // Where a ray meets the disc's plane, four pixels to the right.
    const double x = (kU + 4 - kSceneGrid.cx) / kSceneGrid.fx;
    const double centre_x = (kU - kSceneGrid.cx) / kSceneGrid.fx;
    const double expected = kDepth * (std::sin(tilt) * centre_x - std::cos(tilt)) /
                            (std::sin(tilt) * x - std::cos(tilt));
    EXPECT_NEAR(static_cast<double>(view.depth.at(kU + 4, kV)), expected, 1e-6 * kDepth);
  }
}

TEST(SurfelView, DiscsOfTheNearestSurfaceAreAveragedAndOthersHidden) {
  SurfelArrays surfels;
  const Eigen::Vector3d normal(0, 0, -1);
  for (const double depth : {0.06, 0.05, 0.05, 0.07}) {
    add(surfels, kU, kV, depth, normal, 0.005);
  }
  // Both are met in their centres: their confidences alone weigh them.
  const float expected = (2 * surfels.albedo[1] + 3 * surfels.albedo[2]) /
                         (surfels.confidence[1] + surfels.confidence[2]);
  constexpr float kRounding = 1e-6F;
  for (const std::vector<std::int32_t>& order :
       {std::vector<std::int32_t>{0, 1, 2, 3}, {3, 2, 1, 0}, {2, 0, 1, 3}}) {
    const ModelView view = view_of(surfels, order);
    EXPECT_EQ(view.surfel.at(kU, kV), 1);  // of equals the lowest id
    EXPECT_NEAR(view.depth.at(kU, kV), 0.05F, kRounding);
    EXPECT_NEAR(view.albedo.at(kU, kV), expected, kRounding);
    EXPECT_EQ(view.confidence.at(kU, kV), surfels.confidence[1]);
    EXPECT_EQ(view.normal_z.at(kU, kV), -1);
  }
}

TEST(SurfelView, NoiseOfOverlappingDiscsDoesNotBringTheSurfaceNearer) {
  // As the nearest of several discs alone would: by more than half a sigma of their noise.
  constexpr double kDepth = 0.05;
  constexpr double kNoise = 0.01 * kDepth;
  SurfelArrays surfels;
  for (int v = 10; v < kSceneGrid.height - 10; ++v) {
    for (int u = 10; u < kSceneGrid.width - 10; ++u) {
      const double noise = ((u * 7 + v * 13) % 11 - 5) / 3.16;  // mean 0, variance 1
      add(surfels, u, v, kDepth + kNoise * noise, {0, 0, -1}, 2 * kDepth / kSceneGrid.fx);
      surfels.confidence.back() = 1;
    }
  }
  const ModelView view = view_of(surfels);
  double sum = 0;
  int pixels = 0;
  for (int v = 15; v < kSceneGrid.height - 15; ++v) {
    for (int u = 15; u < kSceneGrid.width - 15; ++u, ++pixels) {
      sum += static_cast<double>(view.depth.at(u, v)) - kDepth;
    }
  }
  EXPECT_LT(std::abs(sum / pixels), 0.1 * kNoise);
}

TEST(SurfelView, DiscOverTheEdgeOfThePictureIsCutThere) {
  SurfelArrays surfels;
  add(surfels, -2, kV, 0.05, {0, 0, -1}, 0.005);  // 4.8 pixels
  const ModelView view = view_of(surfels);
  EXPECT_EQ(view.surfel.at(0, kV), 0);
  EXPECT_EQ(view.surfel.at(2, kV), 0);
  EXPECT_EQ(view.surfel.at(3, kV), -1);
}

TEST(SurfelView, WhatCannotBeSeenLeavesThePictureEmpty) {
  SurfelArrays surfels;
  add(surfels, kU, kV, -0.05, {0, 0, 1}, 0.005);                            // behind
  add(surfels, kU, kV, 0.004, {0, 0, -1}, 0.005);                           // around the camera
  add(surfels, kU, kV, 0.05, {0, 0, 1}, 0.005);                             // from behind
  add(surfels, kU, kV, 0.05, {std::cos(0.05), 0, -std::sin(0.05)}, 0.005);  // edge on
  add(surfels, kU, kV, 2, {0, 0, -1}, 0.5);                                 // too far
  add(surfels, 200, kV, 0.05, {0, 0, -1}, 0.005);                           // beside the picture
  const ModelView view = view_of(surfels);
  EXPECT_EQ(pixels_seen(view), 0);
  EXPECT_EQ(view.depth.at(kU, kV), 0);
  EXPECT_EQ(view.normal_z.at(kU, kV), 0);
  EXPECT_LT(view.albedo.at(kU, kV), 0);
  EXPECT_EQ(view.confidence.at(kU, kV), 0);
}

}  // namespace
}  // namespace gastronaut::slam

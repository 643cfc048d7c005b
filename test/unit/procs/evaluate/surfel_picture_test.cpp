#include "evaluate/surfel_picture.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "evaluate/true_surface.hpp"
#include "numerics/parallel.hpp"
#include "sphere_mesh.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr PinholeGrid kGrid{200, 150, 160, 160, 99.5, 74.5};

Surfel disc(const Eigen::Vector3f& position, const Eigen::Vector3f& normal, float radius,
            std::uint8_t level = 200) {
  return {position, normal.normalized(), {level, level, level}, radius, 20};
}

// The inside of a sphere.
std::vector<Surfel> ball() {
  std::vector<Surfel> surfels;
  for (const Eigen::Vector3d& point : sample_surface(sphere_mesh(), 20000)) {
    surfels.push_back(disc(point.cast<float>(), -point.cast<float>(), 0.0015F));
  }
  return surfels;
}

TEST(DrawSurfels, ADiscCoversItsAreaAtItsDepth) {
  constexpr float kRadius = 0.01F;
  constexpr float kDepth = 0.05F;
  const std::vector<Surfel> one = {disc({0, 0, kDepth}, {0, 0, -1}, kRadius)};
  const SurfelDrawing drawing = draw_surfels(one, {}, {kGrid, SE3{}});
  const double radius_pixels = 160.0 * 0.01 / 0.05;
  const double share = std::numbers::pi * radius_pixels * radius_pixels / (200 * 150);
  // A row of drawn pixels more or less at the rim.
  EXPECT_NEAR(covered(drawing), share, 0.5 * share / radius_pixels);
  for (const float depth : drawing.depth.values) EXPECT_TRUE(depth == 0 || depth == kDepth);
}

TEST(DrawSurfels, ATiltedDiscLiesInItsPlane) {
  const Eigen::Vector3f centre(0.002F, -0.001F, 0.05F);
  const Eigen::Vector3f normal = Eigen::Vector3f(0.5F, 0.3F, -1).normalized();
  const std::vector<Surfel> one = {disc(centre, normal, 0.01F)};
  const SurfelDrawing drawing = draw_surfels(one, {}, {kGrid, SE3{}});
  const PinholeGrid& grid = drawing.grid;
  int seen = 0;
  for (int v = 0; v < grid.height; ++v) {
    for (int u = 0; u < grid.width; ++u) {
      const double z = static_cast<double>(drawing.depth.at(u, v));
      if (z == 0) continue;
      ++seen;
      const Eigen::Vector3d point((u - grid.cx) / grid.fx * z, (v - grid.cy) / grid.fy * z, z);
      const Eigen::Vector3d offset = point - centre.cast<double>();
      constexpr double kFloat = 1e-7;  // metres, rounding of floats at 50 mm
      EXPECT_NEAR(offset.dot(normal.cast<double>()), 0, kFloat);
      EXPECT_LE(offset.norm(), 0.01 + kFloat);
    }
  }
  EXPECT_GT(seen, 0);
}

TEST(DrawSurfels, WhatFacesAwayOrLiesBehindIsNotSeen) {
  const std::vector<Surfel> hidden = {disc({0, 0, 0.05F}, {0, 0, 1}, 0.01F),
                                      disc({0, 0, -0.05F}, {0, 0, 1}, 0.01F),
                                      disc({0, 0, 0.001F}, {0, 0, -1}, 0.01F)};
  EXPECT_EQ(covered(draw_surfels(hidden, {}, {kGrid, SE3{}})), 0);
}

TEST(DrawSurfels, TheNearerHidesTheFarther) {
  const std::vector<Surfel> two = {disc({0, 0, 0.09F}, {0, 0, -1}, 0.01F, 255),
                                   disc({0, 0, 0.05F}, {0, 0, -1}, 0.002F, 0)};
  const std::vector<float> values = {1, 2};
  const SurfelDrawing drawing = draw_surfels(two, values, {kGrid, SE3{}});
  EXPECT_FLOAT_EQ(drawing.value.at(199, 149), 2);
  EXPECT_FLOAT_EQ(drawing.colour.at(199, 149).x(), 0);
  // 10 mm at 90 mm are 35 drawn pixels, 2 mm at 50 mm are 13.
  EXPECT_FLOAT_EQ(drawing.value.at(199 + 25, 149), 1);
  EXPECT_FLOAT_EQ(drawing.colour.at(199 + 25, 149).x(), 1);
}

TEST(DrawSurfels, FarSurfelsLeaveNoHoles) {
  // Smaller than a pixel, one at each pixel.
  std::vector<Surfel> wall;
  for (int v = 0; v < 2 * kGrid.height; ++v) {
    for (int u = 0; u < 2 * kGrid.width; ++u) {
      const auto x = static_cast<float>((u / 2.0 - kGrid.cx) / kGrid.fx);
      const auto y = static_cast<float>((v / 2.0 - kGrid.cy) / kGrid.fy);
      wall.push_back(disc({x, y, 1}, {0, 0, -1}, 1e-5F));
    }
  }
  EXPECT_GT(covered(draw_surfels(wall, {}, {kGrid, SE3{}})), 0.99);  // but for the rims
}

TEST(DrawSurfels, FromInsideABallSeesItAllAround) {
  const std::vector<Surfel> surfels = ball();
  const SurfelDrawing drawing = draw_surfels(surfels, {}, {kGrid, SE3{}});
  EXPECT_EQ(covered(drawing), 1);
  const auto centre = static_cast<double>(drawing.depth.at(199, 149));
  constexpr double kDiscTilt = 1e-4;  // metres: a tilted neighbour's rim is a little nearer
  EXPECT_NEAR(centre, kSphereRadius, kDiscTilt);
}

TEST(DrawSurfels, ThreadsDoNotMatter) {
  const std::vector<Surfel> surfels = ball();
  const std::vector<float> values(surfels.size(), 1);
  const Viewpoint view = outside_views(surfels, {}, 1, 200, 200).front();
  set_thread_count(1);
  const ColourPicture one = paint(draw_surfels(surfels, values, view), Look::kValue, 2, {});
  set_thread_count(3);
  const ColourPicture three = paint(draw_surfels(surfels, values, view), Look::kValue, 2, {});
  set_thread_count(0);
  EXPECT_EQ(one.values, three.values);
}

TEST(Paint, DrawsLinesBeforeTheSurfaceOnly) {
  const std::vector<Surfel> wall = {disc({0, 0, 0.05F}, {0, 0, -1}, 0.02F)};
  const SurfelDrawing drawing = draw_surfels(wall, {}, {kGrid, SE3{}});
  const std::array<std::uint8_t, 3> blue = {255, 0, 0};
  const std::array<std::uint8_t, 3> red = {0, 0, 255};
  const std::vector<Line> lines = {{{{-0.01, 0, 0.04}, {0.01, 0, 0.04}}, blue},
                                   {{{-0.01, 0.005, 0.06}, {0.01, 0.005, 0.06}}, red}};
  const ColourPicture picture = paint(drawing, Look::kShape, 1, lines);
  EXPECT_EQ(picture.at(100, 75), blue);
  EXPECT_EQ(std::count(picture.values.begin(), picture.values.end(), red), 0);
}

TEST(ValueColour, IsMatplotlibsViridis) {
  // matplotlib.cm.viridis([0, 0.5, 1]), in its levels of 255; OpenCV's table is interpolated.
  const auto expect_near = [](const std::array<std::uint8_t, 3>& colour, int b, int g, int r) {
    constexpr int kLevels = 2;
    EXPECT_NEAR(colour[0], b, kLevels);
    EXPECT_NEAR(colour[1], g, kLevels);
    EXPECT_NEAR(colour[2], r, kLevels);
  };
  expect_near(value_colour(0), 84, 1, 68);
  expect_near(value_colour(0.5F), 140, 145, 33);
  expect_near(value_colour(1), 37, 231, 253);
  EXPECT_EQ(value_colour(7), value_colour(1));
}

TEST(OutsideViews, LookIntoABowl) {
  std::vector<Surfel> bowl = ball();
  std::erase_if(bowl, [](const Surfel& surfel) { return surfel.position.z() > -0.01F; });
  const std::vector<Viewpoint> views = outside_views(bowl, {}, 3, 320, 240);
  ASSERT_EQ(views.size(), 3U);
  // It is open above.
  const Eigen::Vector3d forward = views[0].world_T_view.rotation * Eigen::Vector3d::UnitZ();
  EXPECT_LT(forward.z(), -std::cos(10 * std::numbers::pi / 180));  // 200 directions are tried
  for (const Viewpoint& view : views) {
    const SE3 view_T_world = view.world_T_view.inverse();
    for (const Surfel& surfel : bowl) {
      const Eigen::Vector3d point = view_T_world * surfel.position.cast<double>();
      EXPECT_NEAR(view.grid.fx * point.x() / point.z(), 0, view.grid.width / 2.0);
      EXPECT_NEAR(view.grid.fy * point.y() / point.z(), 0, view.grid.height / 2.0);
    }
    EXPECT_GT(covered(draw_surfels(bowl, {}, view)), 0.25);  // and it fills the picture
  }
  EXPECT_TRUE(outside_views({}, {}, 3, 320, 240).empty());
}

}  // namespace
}  // namespace gastronaut::evaluation

// A camera that backs off from a textured wall with its lamp: the wall's albedo stays, its
// luminance falls with the square of the distance.
#include "evaluate/point_constancy.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "evaluate/trajectory_errors.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr PinholeGrid kGrid{64, 48, 60, 60, 31.5, 23.5};
constexpr std::int64_t kPeriod = 200000;  // microseconds
constexpr int kFrames = 11;               // two seconds
constexpr double kNearest = 0.03;         // metres
constexpr double kStep = 0.001;           // metres a frame
constexpr double kFullLevel = 220;        // of albedo 1, near
// Levels are rounded to half of one, and most are above 60; looked up between pixels of a texture
// that bends.
constexpr double kRoundedLevels = 0.01;

double distance(int frame) { return kNearest + kStep * frame; }

// 0.5 to 0.9, slow against the pixels.
double albedo(double x, double y) { return 0.7 + 0.2 * std::sin(300 * x) * std::cos(200 * y); }

struct Wall {
  DepthPicture truth;
  std::vector<Levels> pictures;  // albedo, luminance
};

Wall wall_at(double metres) {
  Wall wall{{kGrid.width, kGrid.height, kGrid.fx, kGrid.fy, kGrid.cx, kGrid.cy, {}},
            {Levels(kGrid.width, kGrid.height), Levels(kGrid.width, kGrid.height)}};
  wall.truth.depth.assign(wall.pictures[0].size(), static_cast<float>(metres));
  const double light = kNearest * kNearest / (metres * metres);
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      const double value = kFullLevel * albedo((u - kGrid.cx) / kGrid.fx * metres,
                                               (v - kGrid.cy) / kGrid.fy * metres);
      wall.pictures[0].at(u, v) = static_cast<std::uint8_t>(std::lround(value));
      wall.pictures[1].at(u, v) = static_cast<std::uint8_t>(std::lround(value * light));
    }
  }
  return wall;
}

// The rig's frame is the wall's; the camera stands `metres` before it.
SE3 pose_at(double metres) {
  SE3 pose;
  pose.translation.z() = -metres;
  return pose;
}

TEST(PointConstancyTest, AlbedoStaysAndLuminanceFallsOffByTheKnownAmount) {
  PointConstancy constancy(2);
  std::vector<double> light;
  for (int i = 0; i < kFrames; ++i) {
    const Wall wall = wall_at(distance(i));
    constancy.add({i * kPeriod, pose_at(distance(i)), wall.truth, kGrid, wall.pictures});
    light.push_back(1 / (distance(i) * distance(i)));
  }
  constancy.finish();
  ASSERT_GT(constancy.points(), 500U);
  const std::vector<Constancy> found = constancy.constancies();
  EXPECT_NEAR(found[0].spread, 0, kRoundedLevels);
  // The references start at 0 and 1 s (and 2 s, too late for five looks); half the points belong to
  // each, and the median lies between their spreads.
  const Statistics from_start = statistics(light);
  const Statistics from_middle = statistics(std::span(light).subspan(5));
  EXPECT_LT(found[1].spread, from_start.std / from_start.mean + kRoundedLevels);
  EXPECT_GT(found[1].spread, from_middle.std / from_middle.mean - kRoundedLevels);
  // Texture makes the same contrast in both, as the wall is lit evenly here.
  EXPECT_GT(found[0].contrast, 0.05);
  EXPECT_NEAR(found[1].contrast, found[0].contrast, kRoundedLevels);
  EXPECT_GT(constancy.distance_ratio(), distance(kFrames - 1) / distance(5) - 0.1);
}

TEST(PointConstancyTest, OneReferenceGivesExactlyTheSpreadOfItsLight) {
  constexpr int kOneReference = 5;  // frames before the second reference starts
  PointConstancy constancy(2);
  std::vector<double> light;
  for (int i = 0; i < kOneReference; ++i) {
    const Wall wall = wall_at(distance(3 * i));
    constancy.add({i * kPeriod, pose_at(distance(3 * i)), wall.truth, kGrid, wall.pictures});
    light.push_back(1 / (distance(3 * i) * distance(3 * i)));
  }
  constancy.finish();
  const Statistics expected = statistics(light);
  EXPECT_EQ(constancy.references(), 1U);
  EXPECT_NEAR(constancy.constancies()[1].spread, expected.std / expected.mean, kRoundedLevels);
}

TEST(PointConstancyTest, AnUnevenLampMakesContrastButNoLocalContrast) {
  // Level 60 + 2 u; points lie at u = 1, 3, ... 61, whose four pixels are inside.
  const auto ramp = [](int u) { return 60.0 + 2 * u; };
  Wall wall = wall_at(kNearest);
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      wall.pictures[1].at(u, v) = static_cast<std::uint8_t>(ramp(u));
    }
  }
  PointConstancy constancy(2);
  for (int i = 0; i < kFrames; ++i) {
    constancy.add({i * kPeriod / 3, pose_at(kNearest), wall.truth, kGrid, wall.pictures});
  }
  constancy.finish();
  std::vector<double> levels;
  std::vector<double> differences;
  for (int u = 1; u <= 61; u += 2) {
    levels.push_back(ramp(u));
    if (u > 1) differences.push_back((ramp(u) - ramp(u - 2)) / (ramp(u - 1) * std::sqrt(2.0)));
  }
  const Statistics over_points = statistics(levels);
  constexpr double kGeometry = 1e-5;  // single-precision depth moves the look-up
  EXPECT_NEAR(constancy.constancies()[1].contrast, over_points.std / over_points.mean, kGeometry);
  EXPECT_NEAR(constancy.constancies()[1].local_contrast, statistics(differences).rmse, kGeometry);
  EXPECT_EQ(constancy.references(), 1U);
}

TEST(PointConstancyTest, HiddenAndMaskedPointsAreNotLookedUp) {
  PointConstancy constancy(2);
  for (int i = 0; i < kFrames; ++i) {
    Wall wall = wall_at(kNearest);
    const int middle = kGrid.width / 2;
    for (int v = 0; v < kGrid.height; ++v) {
      for (int u = 0; u < kGrid.width; ++u) {
        if (u < middle && i > 0) {  // something nearer, and bright, comes before the left half
          wall.truth.depth[static_cast<std::size_t>(v * kGrid.width + u)] =
              static_cast<float>(0.8 * kNearest);
          wall.pictures[0].at(u, v) = wall.pictures[1].at(u, v) = 255;
        } else if (u >= middle && i % 2 == 1) {  // no data in the right half now and then
          wall.pictures[0].at(u, v) = 0;
          wall.pictures[1].at(u, v) = 255;
        }
      }
    }
    // One reference only.
    constancy.add({i * kPeriod / 3, pose_at(kNearest), wall.truth, kGrid, wall.pictures});
  }
  constancy.finish();
  ASSERT_GT(constancy.points(), 100U);
  EXPECT_LT(constancy.points(), 500U);  // half of 32 x 24
  EXPECT_EQ(constancy.constancies()[0].spread, 0);
  EXPECT_EQ(constancy.constancies()[1].spread, 0);
}

TEST(PointConstancyTest, WithoutTruthNothingIsFollowed) {
  PointConstancy constancy(2);
  for (int i = 0; i < kFrames; ++i) {
    Wall wall = wall_at(kNearest);
    wall.truth.depth.assign(wall.truth.depth.size(), 0);
    constancy.add({i * kPeriod, pose_at(kNearest), wall.truth, kGrid, wall.pictures});
  }
  constancy.finish();
  EXPECT_EQ(constancy.points(), 0U);
}

}  // namespace
}  // namespace gastronaut::evaluation

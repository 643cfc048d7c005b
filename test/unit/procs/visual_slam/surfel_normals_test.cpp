#include "visual_slam/surfel_normals.hpp"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <limits>

#include "surfel_scene.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kBend = 0.03;
constexpr double kDistance = 0.03;
const Eigen::Vector3d kNormal = Eigen::Vector3d(0.5, -0.3, -1).normalized();
const Surface kTiltedWall = plane({0, 0, kDistance}, kNormal);

NormalMap normals_of(const Plane<float>& depth, double bend = kBend) {
  NormalMap normals;
  estimate_normals(depth, kSceneGrid, bend, normals);
  return normals;
}

Eigen::Vector3d normal_at(const NormalMap& normals, int u, int v) {
  return Eigen::Vector3f(normals.x.at(u, v), normals.y.at(u, v), normals.z.at(u, v)).cast<double>();
}

TEST(SurfelNormals, AreExactOnAPlane) {
  const NormalMap normals = normals_of(frame_of(kTiltedWall, {}, 0).depth);
  // Slopes of floats over four pixels: 6e-8 * f / 4, with room.
  constexpr double kRounding = 1e-5;
  for (int v = 1; v < kSceneGrid.height - 1; ++v) {
    for (int u = 1; u < kSceneGrid.width - 1; ++u) {
      ASSERT_LT((normal_at(normals, u, v) - kNormal).norm(), kRounding) << u << ' ' << v;
    }
  }
}

TEST(SurfelNormals, NoiseOfDepthIsAveragedOverTheWindow) {
  constexpr double kNoise = 0.002;
  const Frame frame = frame_of(plane({0, 0, kDistance}, {0, 0, -1}), {}, 1, kNoise);
  const NormalMap normals = normals_of(frame.depth);
  double squares = 0;
  int count = 0;
  for (int v = 2; v < kSceneGrid.height - 2; ++v) {
    for (int u = 2; u < kSceneGrid.width - 2; ++u, ++count) {
      squares += std::pow(static_cast<double>(normals.x.at(u, v)), 2);
    }
  }
  // Least squares over 5 x 5 pixels: the sum of the squared offsets is 50.
  const double expected = kNoise * kSceneGrid.fx / std::sqrt(50);
  EXPECT_NEAR(std::sqrt(squares / count), expected, 0.1 * expected);
}

TEST(SurfelNormals, DoNotBendAcrossAStep) {
  Plane<float> depth = frame_of(plane({0, 0, kDistance}, {0, 0, -1}), {}, 0).depth;
  const int step = kSceneGrid.width / 2;
  for (int v = 0; v < kSceneGrid.height; ++v) {
    for (int u = step; u < kSceneGrid.width; ++u) depth.at(u, v) *= 1.5F;
  }
  const NormalMap normals = normals_of(depth);
  for (int u = 1; u < kSceneGrid.width - 1; ++u) {
    const Eigen::Vector3d normal = normal_at(normals, u, kSceneGrid.height / 2);
    if (u == step - 1 || u == step) {
      EXPECT_EQ(normal, Eigen::Vector3d::Zero());  // only upright pairs are left
    } else {
      EXPECT_LT((normal - Eigen::Vector3d(0, 0, -1)).norm(), 1e-5) << u;
    }
  }
}

TEST(SurfelNormals, ThereAreNoneAtTheBorderOrWithoutDepth) {
  Plane<float> depth = frame_of(kTiltedWall, {}, 0).depth;
  depth.at(20, 20) = 0;
  depth.at(30, 20) = std::numeric_limits<float>::quiet_NaN();
  depth.at(40, 20) = std::numeric_limits<float>::infinity();
  depth.at(50, 20) = -1;
  const NormalMap normals = normals_of(depth);
  for (int u : {20, 30, 40, 50}) EXPECT_EQ(normal_at(normals, u, 20), Eigen::Vector3d::Zero());
  EXPECT_EQ(normal_at(normals, 0, 20), Eigen::Vector3d::Zero());
  EXPECT_EQ(normal_at(normals, 20, kSceneGrid.height - 1), Eigen::Vector3d::Zero());
  EXPECT_NEAR(normal_at(normals, 21, 20).norm(), 1, 1e-6);
}

}  // namespace
}  // namespace gastronaut::slam

#include "evaluate/seen_surface.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

namespace gastronaut::evaluation {
namespace {

constexpr std::int64_t kFirst = 1000000;  // microseconds
constexpr std::int64_t kSecond = 2000000;
constexpr double kDistance = 0.04;  // metres, of the wall from the camera at rest
constexpr float kFloat = 1e-8F;     // metres, of depths and positions of centimetres
const SE3 kRigTCamera{so3_exp({0.3, -0.5, 0.1}), {0.01, 0.02, -0.03}};
// Aslant: its distance along the axis is not its distance along a ray.
const Eigen::Vector3d kNormal = Eigen::Vector3d(0.3, -0.2, -1).normalized();  // camera's frame

DepthPicture picture_of(const std::function<double(const Eigen::Vector3d&)>& depth_of_ray) {
  DepthPicture picture{64, 48, 40, 42, 31.5, 23.5, {}, 0};
  for (int v = 0; v < picture.height; ++v) {
    for (int u = 0; u < picture.width; ++u) {
      picture.depth.push_back(static_cast<float>(
          depth_of_ray({(u - picture.cx) / picture.fx, (v - picture.cy) / picture.fy, 1})));
    }
  }
  return picture;
}

// A plane, moved by so much along its normal towards the camera.
DepthPicture wall(double moved) {
  const double offset = kNormal.z() * kDistance + moved;
  return picture_of([=](const Eigen::Vector3d& ray) { return offset / kNormal.dot(ray); });
}

// On the wall at rest where this ray meets it, moved along its normal.
Surfel surfel_at(double x, double y, double moved, std::int64_t utime) {
  const Eigen::Vector3d ray(x, y, 1);
  const Eigen::Vector3d place = kNormal.z() * kDistance / kNormal.dot(ray) * ray + moved * kNormal;
  Surfel surfel;
  surfel.position = (kRigTCamera * place).cast<float>();
  surfel.normal = (kRigTCamera.rotation * kNormal).cast<float>();
  surfel.measured_utime = utime;
  return surfel;
}

TEST(SeenSurfaceTest, ComparesWithTheWallAsItWasInTheLastPictureOfASurfel) {
  constexpr double kMove = 0.003;
  constexpr double kError = 0.0005;
  const std::vector<Surfel> surfels = {surfel_at(0.1, 0.1, kError, kFirst),
                                       surfel_at(-0.2, 0.05, kMove - kError, kSecond)};
  SeenSurface seen(surfels, SE3{});
  seen.add(kFirst, wall(0), kRigTCamera);
  seen.add(kSecond, wall(kMove), kRigTCamera);
  const std::vector<double> distances = seen.distances();
  ASSERT_EQ(distances.size(), 2U);
  for (const double distance : distances) EXPECT_NEAR(distance, kError, kFloat);
}

TEST(SeenSurfaceTest, KeepsTheLastPictureThatHadTheSurfelInView) {
  constexpr double kError = 0.0005;
  const std::vector<Surfel> surfels = {surfel_at(0.1, 0.1, kError, kSecond)};
  SeenSurface seen(surfels, SE3{});
  seen.add(kFirst, wall(0), kRigTCamera);
  const SE3 turned_away = kRigTCamera * SE3{so3_exp({0, 3, 0}), {}};
  seen.add(kSecond, wall(0.003), turned_away);
  ASSERT_EQ(seen.distances().size(), 1U);
  EXPECT_NEAR(seen.distances()[0], kError, kFloat);
}

TEST(SeenSurfaceTest, TheMapIsWhereItIsPlaced) {
  constexpr double kShift = 0.001;
  const std::vector<Surfel> surfels = {surfel_at(0.1, 0.1, 0, kFirst)};
  const Eigen::Vector3d shift = kShift * (kRigTCamera.rotation * kNormal);
  SeenSurface seen(surfels, {Eigen::Quaterniond::Identity(), shift});
  seen.add(kFirst, wall(0), kRigTCamera);
  ASSERT_EQ(seen.distances().size(), 1U);
  EXPECT_NEAR(seen.distances()[0], kShift, kFloat);
}

TEST(SeenSurfaceTest, WhatIsHiddenOrOutsideOrTurnedAwayIsNotCompared) {
  Surfel turned = surfel_at(0, 0, 0, kFirst);
  turned.normal = -turned.normal;
  const std::vector<Surfel> surfels = {
      surfel_at(0, 0, 0.3 * kDistance, kFirst), surfel_at(0, 0, -0.3 * kDistance, kFirst),
      surfel_at(0.9, 0, 0, kFirst), surfel_at(0, 0, -2 * kDistance, kFirst), turned};
  SeenSurface seen(surfels, SE3{});
  seen.add(kFirst, wall(0), kRigTCamera);
  EXPECT_TRUE(seen.distances().empty());
}

TEST(SeenSurfaceTest, WhereThePictureHasNoDepthOrAnEdgeNothingIsSaid) {
  const std::vector<Surfel> surfels = {surfel_at(0, 0, 0, kFirst)};
  SeenSurface seen(surfels, SE3{});
  seen.add(kFirst, picture_of([](const Eigen::Vector3d&) { return 0.0; }), kRigTCamera);
  // An edge between the pixels to the left and to the right of the surfel's.
  seen.add(kFirst, picture_of([](const Eigen::Vector3d& ray) {
             return (ray.x() > 0 ? 1.15 : 1.0) * kDistance;
           }),
           kRigTCamera);
  EXPECT_TRUE(seen.distances().empty());
}

}  // namespace
}  // namespace gastronaut::evaluation

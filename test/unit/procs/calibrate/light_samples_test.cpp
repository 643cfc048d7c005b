#include "calibrate/light_samples.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace gastronaut {
namespace {

constexpr int kWidth = 320;
constexpr int kHeight = 240;
constexpr double kFocal = 160;

CameraModel pinhole() {
  return CameraModel(
      {kWidth, kHeight, kFocal, kFocal, 159.5, 119.5, LensModel::kRadialTangential, {}});
}

std::array<Plane<std::uint8_t>, 3> even_picture(std::uint8_t level) {
  const Plane<std::uint8_t> channel(kWidth, kHeight, level);
  return {channel, channel, channel};
}

DepthMap depth_of(const Eigen::Vector3d& plane, double count) {
  DepthMap map{Plane<float>(kWidth, kHeight), kFocal, kFocal, 159.5, 119.5};
  for (int row = 0; row < kHeight; ++row) {
    for (int col = 0; col < kWidth; ++col) {
      const Eigen::Vector3d ray((col - map.cx) / kFocal, (row - map.cy) / kFocal, 1);
      map.depth.at(col, row) = static_cast<float>(std::round(1 / plane.dot(ray) / count) * count);
    }
  }
  return map;
}

TEST(LightSamples, TakesNeitherSaturatedNorDarkPlacesAndSaysWhatBecameOfAll) {
  auto picture = even_picture(100);
  for (int row = 0; row < kHeight; ++row) {
    for (int col = 0; col < kWidth / 4; ++col) {
      picture[1].at(col, row) = 255;  // one channel is enough
      picture[0].at(kWidth - 1 - col, row) = 3;
    }
  }
  SampleCounts counts;
  const auto samples = take_samples(picture, pinhole(), std::nullopt, counts);
  EXPECT_EQ(counts.used, static_cast<std::int64_t>(samples.size()));
  EXPECT_EQ(counts.saturated, counts.total() / 4);
  EXPECT_EQ(counts.dark, counts.total() / 4);
  for (const LightSample& sample : samples) {
    EXPECT_DOUBLE_EQ(sample.level, 100.0 / 255);
    EXPECT_LT(std::abs(sample.ray.x()), 0.5 * 160 / kFocal);
  }
}

TEST(LightSamples, KnownDepthGivesTheWallsPlaneAtEachPlace) {
  constexpr double kCount = 5e-5;  // metres, as depth pictures have
  // Rounding, a third of a count per pixel at 33 mm, over the slope of 25 pixels 0.2 mm apart.
  constexpr double kOfRounding = 0.02;
  const Eigen::Vector3d plane(14, -9, 30);  // tilted by 29 degrees: beyond the highlights' reach
  SampleCounts counts;
  const auto samples = take_samples(even_picture(120), pinhole(), depth_of(plane, kCount), counts);
  ASSERT_GT(samples.size(), 300U);
  double squares = 0;
  for (const LightSample& sample : samples) squares += (sample.plane - plane).squaredNorm();
  EXPECT_LT(std::sqrt(squares / static_cast<double>(samples.size())), kOfRounding * plane.norm());
}

TEST(LightSamples, LeavesOutWhatIsSeenFaceOnSinceMucusShinesThere) {
  SampleCounts counts;
  const auto samples =
      take_samples(even_picture(120), pinhole(), depth_of({0, 0, 30}, 1e-6), counts);
  for (const LightSample& sample : samples) {
    constexpr double kTan20 = 0.364;
    EXPECT_GT(sample.ray.head<2>().norm(), kTan20);
  }
  EXPECT_GT(counts.unsuitable, 0);
}

TEST(LightSamples, LeavesOutEdgesAndHolesOfTheDepth) {
  DepthMap map = depth_of({14, -9, 30}, 1e-6);
  for (int row = 0; row < kHeight; ++row) {
    for (int col = 0; col < kWidth; ++col) {
      // A comb of folds 2 mm high, five pixels wide, and a hole below.
      if (col % 10 < 5) map.depth.at(col, row) -= 0.002F;
      if (row >= kHeight / 2) map.depth.at(col, row) = 0;
    }
  }
  SampleCounts counts;
  const auto samples = take_samples(even_picture(120), pinhole(), map, counts);
  // The fit's width is five pixels: at most one place in ten has a tooth or a gap to itself.
  constexpr double kOnTeeth = 0.25;
  EXPECT_LT(static_cast<double>(samples.size()), kOnTeeth * static_cast<double>(counts.total()));
  EXPECT_GE(counts.without_depth, counts.total() / 2);
}

TEST(LightSamples, PlacesAreThoseOfTheWallWhereverTheCameraWas) {
  LightPicture picture;
  LightSample ahead;
  ahead.ray = {0, 0, 1};
  ahead.plane = {0, 0, 50};  // 20 mm away
  LightSample aside = ahead;
  aside.ray = {0.5, 0, 1};  // 10 mm to the side
  picture.samples = {ahead, aside};
  // The second camera is 10 mm to the side of the first: it has the first one's `aside` ahead.
  SE3 moved;
  moved.translation = {0.01, 0, 0};
  std::vector<LightPicture> pictures = {picture, picture};
  number_places({SE3(), moved}, pictures);
  EXPECT_NE(pictures[0].samples[0].place, pictures[0].samples[1].place);
  EXPECT_EQ(pictures[0].samples[1].place, pictures[1].samples[0].place);
  // Without poses all that a picture sees is one place.
  number_places({std::nullopt, std::nullopt}, pictures);
  EXPECT_EQ(pictures[0].samples[0].place, pictures[0].samples[1].place);
  EXPECT_NE(pictures[0].samples[0].place, pictures[1].samples[0].place);
}

TEST(PoseFromMagnet, TellsTheCameraButForATurnAboutTheMagnetsAxis) {
  SE3 camera_T_magnet;
  camera_T_magnet.translation = {0.001, -0.0005, -0.009};
  camera_T_magnet.rotation = so3_exp({0.05, -0.03, 0.4});
  SE3 rig_T_camera;
  rig_T_camera.translation = {0.01, 0.02, 0.03};
  rig_T_camera.rotation = so3_exp({2.8, 0.3, -0.2});
  const SE3 rig_T_magnet = rig_T_camera * camera_T_magnet;
  constexpr double kPosition = 2e-4;  // metres
  constexpr double kAngle = 5e-3;     // radians
  Matrix5d covariance = Matrix5d::Zero();
  covariance.diagonal().head<3>().setConstant(kPosition * kPosition);
  covariance.diagonal().tail<2>().setConstant(kAngle * kAngle);
  const CameraPosePrior prior =
      pose_from_magnet(rig_T_magnet.translation, rig_T_magnet.rotation * Eigen::Vector3d::UnitZ(),
                       covariance, camera_T_magnet, 1e-9, 1e-9);
  // The magnet is where it was told to be, and only a turn about its axis is left.
  const SE3 told = prior.rig_T_camera * camera_T_magnet;
  constexpr double kRounding = 1e-9;
  EXPECT_LT((told.translation - rig_T_magnet.translation).norm(), kRounding);
  const Eigen::Vector3d turn =
      so3_log(prior.rig_T_camera.rotation.conjugate() * rig_T_camera.rotation);
  ASSERT_TRUE(prior.roll_axis);
  EXPECT_LT(prior.roll_axis->cross(turn).norm(), kRounding);
  EXPECT_LT((prior.rig_T_camera * prior.roll_centre - rig_T_magnet.translation).norm(), kRounding);

  // A turn about that axis, through the magnet, costs next to nothing; a sigma across it costs one.
  Vector6d roll;
  roll << -prior.roll_axis->cross(prior.roll_centre), *prior.roll_axis;
  constexpr double kNextToNothing = 0.1;
  EXPECT_LT(roll.dot(prior.information * roll), kNextToNothing);
  const Eigen::Vector3d across = prior.roll_axis->unitOrthogonal();
  Vector6d tilt;
  tilt << -across.cross(prior.roll_centre), across;
  tilt *= kAngle;
  EXPECT_NEAR(tilt.dot(prior.information * tilt), 1, 1e-6);
  Vector6d shift = Vector6d::Zero();
  shift(1) = kPosition;
  EXPECT_NEAR(shift.dot(prior.information * shift), 1, 1e-6);
}

}  // namespace
}  // namespace gastronaut

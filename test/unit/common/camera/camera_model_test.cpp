#include "camera/camera_model.hpp"

#include <gtest/gtest.h>

#include <opencv2/calib3d.hpp>
#include <stdexcept>

#include "numerics/counter_random.hpp"

namespace gastronaut {
namespace {

constexpr double kPixelRounding = 1e-9;
constexpr double kRayRounding = 1e-10;

CameraIntrinsics endoscope(LensModel model, std::vector<double> distortion) {
  return {640, 480, 332.8, 330.1, 321.8, 237.8, model, std::move(distortion)};
}

Eigen::Vector3d point_in_view(std::uint64_t index) {
  const CounterRandom random(5, index);
  return {0.04 * (random.uniform(0) - 0.5), 0.03 * (random.uniform(1) - 0.5),
          0.02 + 0.05 * random.uniform(2)};
}

Eigen::Vector2d project_with_opencv(const CameraIntrinsics& in, const Eigen::Vector3d& point) {
  const cv::Matx33d matrix(in.fx, 0, in.cx, 0, in.fy, in.cy, 0, 0, 1);
  const std::vector<cv::Point3d> points = {{point.x(), point.y(), point.z()}};
  std::vector<cv::Point2d> pixels;
  if (in.model == LensModel::kFisheye) {
    cv::fisheye::projectPoints(points, pixels, cv::Vec3d(), cv::Vec3d(), matrix, in.distortion);
  } else {
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), matrix, in.distortion, pixels);
  }
  return {pixels[0].x, pixels[0].y};
}

class CameraModelTest : public ::testing::TestWithParam<CameraIntrinsics> {};

TEST_P(CameraModelTest, ProjectsAsOpenCvDoes) {
  const CameraModel camera(GetParam());
  for (std::uint64_t i = 0; i < 200; ++i) {
    const Eigen::Vector3d point = point_in_view(i);
    const auto pixel = camera.project(point);
    ASSERT_TRUE(pixel);
    EXPECT_LT((*pixel - project_with_opencv(GetParam(), point)).norm(), kPixelRounding);
  }
}

TEST_P(CameraModelTest, UnprojectInvertsProject) {
  const CameraModel camera(GetParam());
  for (std::uint64_t i = 0; i < 200; ++i) {
    const Eigen::Vector3d point = point_in_view(i);
    const auto ray = camera.unproject(camera.project(point).value());
    ASSERT_TRUE(ray);
    EXPECT_LT((*ray - point.normalized()).norm(), kRayRounding);
  }
}

TEST_P(CameraModelTest, JacobianMatchesFiniteDifference) {
  const CameraModel camera(GetParam());
  constexpr double kStep = 1e-8;      // metres
  constexpr double kRelative = 1e-4;  // truncation and rounding of the difference
  for (std::uint64_t i = 0; i < 20; ++i) {
    const Eigen::Vector3d point = point_in_view(i);
    Eigen::Matrix<double, 2, 3> jacobian;
    camera.project(point, jacobian);
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(axis);
      const Eigen::Vector2d slope =
          (*camera.project(point + step) - *camera.project(point - step)) / (2 * kStep);
      EXPECT_LT((slope - jacobian.col(axis)).norm(), kRelative * jacobian.norm());
    }
  }
}

INSTANTIATE_TEST_SUITE_P(
    Lenses, CameraModelTest,
    ::testing::Values(endoscope(LensModel::kRadialTangential, {}),
                      endoscope(LensModel::kRadialTangential, {-0.12, 0.018, 0, 0}),
                      endoscope(LensModel::kRadialTangential, {-0.2, 0.05, 1e-3, -2e-3, 0.01}),
                      endoscope(LensModel::kRadialTangential,
                                {0.3, 0.1, 1e-3, -2e-3, 0.01, 0.5, 0.1, 0.02}),
                      endoscope(LensModel::kFisheye, {0, 0, 0, 0}),
                      endoscope(LensModel::kFisheye, {0.05, -0.01, 0.002, -0.0005})));

TEST(CameraModel, PointBehindTheCameraIsNotProjected) {
  const CameraModel camera(endoscope(LensModel::kRadialTangential, {}));
  EXPECT_FALSE(camera.project({0, 0, -0.01}));
  EXPECT_FALSE(camera.project({0, 0, 0}));
}

TEST(CameraModel, PointBeyondTheFoldOfTheDistortionIsNotProjected) {
  // r (1 - 0.3 r^2) turns back at r = sqrt(1 / 0.9) = 1.054.
  const CameraModel camera(endoscope(LensModel::kRadialTangential, {-0.3}));
  EXPECT_TRUE(camera.project({0.0104, 0, 0.01}));
  EXPECT_FALSE(camera.project({0.0107, 0, 0.01}));
}

TEST(CameraModel, PixelThatNoRayReachesHasNone) {
  // The largest distorted radius of the lens above is 1.054 * 2/3 = 0.703.
  CameraIntrinsics in = endoscope(LensModel::kRadialTangential, {-0.3});
  const CameraModel camera(in);
  EXPECT_TRUE(camera.unproject({in.cx + 0.70 * in.fx, in.cy}));
  EXPECT_FALSE(camera.unproject({in.cx + 0.71 * in.fx, in.cy}));
}

TEST(CameraModel, ImpossibleIntrinsicsAreRefused) {
  CameraIntrinsics in = endoscope(LensModel::kFisheye, {0, 0, 0, 0, 0});
  EXPECT_THROW(CameraModel{in}, std::invalid_argument);
  in.distortion.clear();
  in.fx = 0;
  EXPECT_THROW(CameraModel{in}, std::invalid_argument);
  in.fx = 300;
  in.width = 0;
  EXPECT_THROW(CameraModel{in}, std::invalid_argument);
}

}  // namespace
}  // namespace gastronaut

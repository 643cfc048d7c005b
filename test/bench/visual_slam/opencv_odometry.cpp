#include "bench/visual_slam/opencv_odometry.hpp"

#include <cstddef>
#include <limits>

namespace gastronaut::slam {
namespace {

constexpr double kRoom = 2;           // metres, the working distance that OpenCV's defaults suit
constexpr double kMostMotion = 0.3;   // working distances from frame to frame
constexpr double kMostRotation = 30;  // degrees

SE3 to_transform(const cv::Mat& matrix, double scale) {
  Eigen::Matrix3d rotation;
  Eigen::Vector3d translation;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) rotation(i, j) = matrix.at<double>(i, j);
    translation(i) = matrix.at<double>(i, 3) / scale;
  }
  return {Eigen::Quaterniond(rotation).normalized(), translation};
}

}  // namespace

OpencvOdometry::OpencvOdometry(const PinholeGrid& grid, double working_distance, double farthest)
    : scale_(kRoom / working_distance) {
  const cv::Mat camera =
      (cv::Mat_<float>(3, 3) << grid.fx, 0, grid.cx, 0, grid.fy, grid.cy, 0, 0, 1);
  odometry_ = cv::rgbd::RgbdICPOdometry::create(camera);
  odometry_->setMaxDepth(kRoom * farthest);
  odometry_->setMaxTranslation(kRoom * kMostMotion);
  odometry_->setMaxRotation(kMostRotation);
}

std::optional<SE3> OpencvOdometry::track(const Plane<float>& depth,
                                         const std::vector<std::uint8_t>& levels) {
  cv::Mat image(depth.height, depth.width, CV_8U);
  cv::Mat metres(depth.height, depth.width, CV_32F);
  cv::Mat mask(depth.height, depth.width, CV_8U);
  for (std::size_t i = 0; i < depth.size(); ++i) {
    const bool known = depth.values[i] > 0;
    image.data[i] = levels[i];
    mask.data[i] = known && levels[i] > 0 ? 255 : 0;
    metres.ptr<float>()[i] = known ? static_cast<float>(depth.values[i] * scale_)
                                   : std::numeric_limits<float>::quiet_NaN();
  }
  auto current = cv::rgbd::OdometryFrame::create(image, metres, mask);
  std::optional<SE3> previous_T_current;
  if (previous_) {
    cv::Mat motion;
    if (odometry_->compute(current, previous_, motion) && !motion.empty()) {
      previous_T_current = to_transform(motion, scale_);
    }
  }
  previous_ = current;
  return previous_T_current;
}

}  // namespace gastronaut::slam

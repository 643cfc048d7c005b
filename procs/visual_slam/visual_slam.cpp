#include "visual_slam/visual_slam.hpp"

#include <cmath>
#include <utility>

namespace gastronaut::slam {
namespace {

constexpr double kMicrosecond = 1e-6;
constexpr double kLongestPrediction = 0.3;  // seconds that a velocity is trusted

}  // namespace

VisualSlam::VisualSlam(const VisualSlamOptions& options) : options_(options), map_(options.map) {}

VisualSlam::VisualSlam(const VisualSlamOptions& options, SurfelArrays kept)
    : options_(options), map_(options.map, std::move(kept)) {}

SE3 VisualSlam::predicted_pose(std::int64_t utime) const {
  const double ahead = static_cast<double>(utime - utime_) * kMicrosecond;
  if (ahead > kLongestPrediction) return *map_T_camera_;
  return *map_T_camera_ * SE3::exp(velocity_ * ahead);
}

SlamPose VisualSlam::track(const Frame& frame, const PictureHealth& health,
                           const std::optional<SE3>& map_T_camera_start) {
  if (!health.failure.empty()) return lost(frame.utime, health);
  frame_ = frame;
  pose_ = {};
  pose_.utime = frame.utime;
  if (map_T_camera_) pose_.map_T_camera = *map_T_camera_;
  if (!map_T_camera_) {
    map_T_camera_ = map_T_camera_start.value_or(SE3{});
    utime_ = frame.utime;
    pose_.map_T_camera = *map_T_camera_;
    pose_.status = SlamStatus::kOk;
    return pose_;
  }
  if (!tracker_) tracker_.emplace(frame.grid, options_.tracker);
  const SE3 start = map_T_camera_start.value_or(predicted_pose(frame.utime));
  map_.predict(start, frame.grid, frame.utime, MapPart::kActive, view_);
  const TrackingResult result = tracker_->track(frame, view_, start);
  pose_.cause = result.cause;
  pose_.icp_rms = result.icp_rms;
  pose_.rgb_rms = result.rgb_rms;
  pose_.inlier_fraction = result.inlier_fraction;
  pose_.depth_scale = result.depth_scale;
  if (result.status == TrackingStatus::kLost) return pose_;
  pose_.status = result.status == TrackingStatus::kOk ? SlamStatus::kOk : SlamStatus::kDegraded;
  pose_.map_T_camera = result.map_T_camera;
  pose_.covariance = result.covariance;
  const double elapsed = static_cast<double>(frame.utime - utime_) * kMicrosecond;
  velocity_ = (map_T_camera_->inverse() * result.map_T_camera).log() / elapsed;
  map_T_camera_ = result.map_T_camera;
  utime_ = frame.utime;
  return pose_;
}

SlamPose VisualSlam::lost(std::int64_t utime, const PictureHealth& health) {
  pose_ = {};
  pose_.utime = utime;
  if (map_T_camera_) pose_.map_T_camera = *map_T_camera_;
  pose_.cause = health.failure_message.empty() ? health.failure : health.failure_message;
  return pose_;
}

FuseReport VisualSlam::merge(const std::optional<SE3>& fused) {
  if (pose_.status == SlamStatus::kLost) return {};
  const SE3 pose = fused.value_or(pose_.map_T_camera);
  const auto scale = static_cast<float>(std::pow(pose_.depth_scale, 1 - options_.own_scale));
  for (float& depth : frame_.depth.values) depth *= scale;
  map_.predict(pose, frame_.grid, frame_.utime, MapPart::kActive, view_);
  return map_.fuse(frame_, view_);
}

}  // namespace gastronaut::slam

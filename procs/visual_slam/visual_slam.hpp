// Dense visual SLAM: each frame is tracked against the predicted view of the map, then merged into
// it (paper, sections on magneto-visual pose estimation and map fusion).
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "geometry/se3.hpp"
#include "visual_slam/frame.hpp"
#include "visual_slam/frame_tracker.hpp"
#include "visual_slam/surfel_map.hpp"

namespace gastronaut::slam {

// What is known of the picture besides the frame made of it.
struct PictureHealth {
  std::string failure;  // why it cannot be used, one word; empty: it can
  std::string failure_message;
  double sharpness = 0;  // 0: not told; compared with that of the pictures before
};

struct VisualSlamOptions {
  TrackerOptions tracker;
  SurfelMapOptions map;
  // How much of each frame's own scale is kept when it is fitted to the map's: their mean is what
  // holds the map's scale.
  double own_scale = 0.1;
};

enum class SlamStatus : std::int8_t { kOk = 0, kDegraded = 1, kLost = 2, kRelocalised = 3 };

struct SlamPose {
  std::int64_t utime = 0;
  SlamStatus status = SlamStatus::kLost;
  std::string cause;                       // why it is not kOk
  SE3 map_T_camera;                        // the last known when kLost
  Matrix6d covariance = Matrix6d::Zero();  // translation m^2, rotation rad^2, camera frame
  double icp_rms = 0;                      // as in TrackingResult
  double rgb_rms = 0;
  double inlier_fraction = 0;
  double depth_scale = 1;
};

// The map's frame is that of the first frame's camera, unless a map was given.
class VisualSlam {
 public:
  // Throws std::invalid_argument for options that make no sense.
  explicit VisualSlam(const VisualSlamOptions& options);
  VisualSlam(const VisualSlamOptions& options, SurfelArrays kept);

  // Where the camera is. utimes ascend. `map_T_camera_start`: where it is thought to be, from
  // elsewhere; else where constant velocity leads.
  SlamPose track(const Frame& frame, const PictureHealth& health,
                 const std::optional<SE3>& map_T_camera_start = std::nullopt);
  // The same for a picture of which no frame could be made.
  SlamPose lost(std::int64_t utime, const PictureHealth& health);
  // Merges the frame tracked last into the map, at its own pose or at `fused`; nothing when lost.
  FuseReport merge(const std::optional<SE3>& fused = std::nullopt);

  const SurfelMap& map() const { return map_; }
  MapIncrement take_increment() { return map_.take_increment(); }

 private:
  SE3 predicted_pose(std::int64_t utime) const;

  VisualSlamOptions options_;
  SurfelMap map_;
  std::optional<FrameTracker> tracker_;
  ModelView view_;

  Frame frame_;    // tracked last
  SlamPose pose_;  // of it
  // Of the last two frames that were tracked.
  std::optional<SE3> map_T_camera_;
  std::int64_t utime_ = 0;
  Vector6d velocity_ = Vector6d::Zero();  // twist a second, camera frame
};

}  // namespace gastronaut::slam

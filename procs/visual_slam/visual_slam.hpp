// Dense visual SLAM: each frame is tracked against the predicted view of the map, then merged into
// it (paper, sections on magneto-visual pose estimation and map fusion).
//
// A depth that is nearly certain (a sensor's) is merged frame by frame. One that is not (from
// shading) is merged by keyframes: the last of them are refined together first, poses and depths
// (keyframe_window.hpp), on a thread of its own, and what it found is used a fixed number of frames
// later, so that results do not depend on how fast the thread was.
#pragma once

#include <cstdint>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "geometry/se3.hpp"
#include "visual_slam/frame.hpp"
#include "visual_slam/frame_tracker.hpp"
#include "visual_slam/keyframe_window.hpp"
#include "visual_slam/relocaliser.hpp"
#include "visual_slam/surfel_file.hpp"
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
  KeyframeWindowOptions window;
  RelocaliserOptions relocaliser;

  double least_depth = 0.2;      // of a picture within the map's reach: less begins no map
  double certain_depth = 0.01;   // frames of at most this relative_std are merged as they are
  double keyframe_shift = 0.08;  // a keyframe: so far from the last, in distances to what is seen,
  double keyframe_turn = 0.15;   // or turned so far, radians,
  double longest_gap = 0.3;      // or, without either, so many seconds since the last merge: then
                                 // it is merged as it is
  double least_points = 0.4;     // DEGRADED: fewer of window.points hold the newest keyframe
  int refinement_frames = 2;     // frames from a keyframe to when it counts as refined
  // How much of each frame's own scale is kept when it is fitted to the map's: their mean is what
  // holds the map's scale. For frames that are merged as they are.
  double own_scale = 0.1;
  double blur = 0.5;  // DEGRADED below this fraction of the sharpness that pictures had lately
  // A camera does not move farther between two frames, in distances to what is seen and radians.
  double largest_shift = 0.4;
  double largest_turn = 0.5;
  int candidates = 2;  // places tried for each frame while lost
};

enum class SlamStatus : std::int8_t { kOk = 0, kDegraded = 1, kLost = 2, kRelocalised = 3 };

struct SlamPose {
  std::int64_t utime = 0;
  SlamStatus status = SlamStatus::kLost;
  std::string cause;  // why it is not kOk
  SE3 map_T_camera;   // the last known when kLost
  // Translation m^2, rotation rad^2, camera frame: of the pose in relation to the map's first
  // keyframe, drift since then included. Zero when kLost.
  Matrix6d covariance = Matrix6d::Zero();
  double icp_rms = 0;  // as in TrackingResult
  double rgb_rms = 0;
  double inlier_fraction = 0;
  double depth_scale = 1;
};

// The map's frame is that of the first frame's camera, unless a map was given: then the camera is
// lost until it finds itself there.
class VisualSlam {
 public:
  // Throws std::invalid_argument for options that make no sense.
  explicit VisualSlam(const VisualSlamOptions& options);
  VisualSlam(const VisualSlamOptions& options, KeptMap kept);

  // Where the camera is. utimes ascend. `map_T_camera_start`: where it is thought to be, from
  // elsewhere; else where constant velocity leads. Throws std::invalid_argument when the frame's
  // grid is too small, or not that of the frame that the map began with.
  SlamPose track(const Frame& frame, const PictureHealth& health,
                 const std::optional<SE3>& map_T_camera_start = std::nullopt);
  // The same for a picture of which no frame could be made.
  SlamPose lost(std::int64_t utime, const PictureHealth& health);
  // Merges the frame tracked last into the map, at its own pose or at `fused`; nothing when lost.
  void merge(const std::optional<SE3>& fused = std::nullopt);

  // The end: what is still being refined is merged as well.
  void settle();

  const SurfelMap& map() const { return map_; }
  MapIncrement take_increment() { return map_.take_increment(); }
  // What is needed to go on with the map another time.
  KeptMap kept() const;

 private:
  struct Keyframe {
    Frame frame;
    SE3 map_T_camera;
  };

  void prepare(const PinholeGrid& grid);
  SE3 predicted_pose(std::int64_t utime) const;
  void begin(const Frame& frame, const SE3& map_T_camera);
  void use_refinement();
  TrackingResult track_near(const Frame& frame, const SE3& start);
  TrackingResult track_from(const Frame& frame, const SE3& start);
  bool confirmed(const Frame& frame, const TrackingResult& result);
  std::optional<TrackingResult> relocalise(const Frame& frame);
  void accept(const Frame& frame, const TrackingResult& result);
  bool is_blurred(double sharpness);
  bool is_far_from_keyframe() const;
  void refine(const Frame& frame, const SE3& map_T_camera);
  void anchor(const SE3& map_T_camera, const Matrix6d& covariance);
  void merge_as_is(const Frame& frame, const SE3& map_T_camera);

  VisualSlamOptions options_;
  SurfelMap map_;
  std::vector<SE3> kept_viewpoints_;
  PinholeGrid grid_;
  std::optional<FrameTracker> tracker_;  // these three since the first frame
  std::optional<Relocaliser> relocaliser_;
  ModelView view_;

  Frame frame_;    // tracked last
  SlamPose pose_;  // of it
  bool is_sharp_ = true;
  bool is_held_ = true;  // in all directions

  // Of the last frame that was tracked.
  std::optional<SE3> map_T_camera_;
  std::int64_t utime_ = 0;
  Vector6d velocity_ = Vector6d::Zero();  // twist a second, camera frame
  bool is_lost_ = false;
  double distance_ = 0;                // metres, median depth
  double sharpness_ = 0;               // lately
  Matrix6d drift_ = Matrix6d::Zero();  // covariance of reference_, camera frame there

  SE3 reference_;  // pose of the last keyframe
  SE3 anchor_;     // where the present thread of keyframes began, and how well that is known
  Matrix6d anchor_covariance_ = Matrix6d::Zero();
  bool has_begun_ = false;  // something was merged
  std::int64_t merged_utime_ = 0;
  std::unique_ptr<KeyframeWindow> window_;
  std::optional<Keyframe> newest_;  // being refined
  std::optional<ModelView> model_;  // the newest refined keyframe as it saw
  int refined_points_ = 0;          // that hold it
  int frames_since_keyframe_ = 0;
  std::future<std::vector<RefinedKeyframe>> refining_;  // after window_: is waited for first
};

}  // namespace gastronaut::slam

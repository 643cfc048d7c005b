// Dense visual SLAM: each frame is tracked against the predicted view of the map, then merged into
// it (paper, sections on magneto-visual pose estimation and map fusion).
//
// A depth that is nearly certain (a sensor's) is merged frame by frame. One that is not (from
// shading) is merged by keyframes: the last of them are refined together first, poses and depths
// (keyframe_window.hpp), on a thread of its own, and what it found is used a fixed number of frames
// later, so that results do not depend on how fast the thread was.
//
// What sensor fusion makes of the frames enters the map in steps alone, and each is told by the
// map's version, so that fusion, which takes the poses here for vision's own, counts nothing twice.
// Once the fused pose is trusted the map goes to the rig's frame and to metres; and when tracking
// was lost for long, it begins again where fusion has the camera. Where fusion does not know that
// well enough (a magnet does not tell its roll), a new map is begun, and joined with the one before
// as soon as the new one goes to the rig's frame.
//
// The map bends (map_deformer.hpp): to where fusion has the cameras that saw it, onto itself where
// the camera comes back to it, and after a wall that has moved. Vision goes on as it did; where its
// frame lies in the map is what changes, so that no pose jumps, and fusion, which has the magnet
// against vision's drift, does not hear of it. Where fusion has been silent poses go with the map.
#pragma once

#include <cstdint>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "geometry/se3.hpp"
#include "visual_slam/frame.hpp"
#include "visual_slam/frame_tracker.hpp"
#include "visual_slam/keyframe_window.hpp"
#include "visual_slam/loop_search.hpp"
#include "visual_slam/map_deformer.hpp"
#include "visual_slam/relocaliser.hpp"
#include "visual_slam/similarity.hpp"
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
  LoopSearchOptions loops;
  MapDeformerOptions deformer;  // its lengths go with map.working_distance

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

  // Fused poses with one sigma of at most this, in their worst direction, metres and radians, take
  // the map to the rig's frame, and again whenever the rotation is known twice as well or the scale
  // turns out to be off by rebase_scale (scale changes in no other way: fusion relies on that),
  double rebase_position_std = 0.002;
  double rebase_rotation_std = 0.05;
  double rebase_scale = 0.015;
  // So well known, the map stays where it is, and vision alone is turned, shifted and scaled;
  // unless the map is what it is tracked against, as with depths that are nearly certain.
  double settled_rotation_std = 0.017;
  // respectively are where tracking begins again after so many seconds of usable pictures without a
  // place.
  double restart_position_std = 0.003;
  double restart_rotation_std = 0.1;
  double restart_after = 0.25;
  double new_map_after = 0.7;  // the same, where fused poses are not trusted: a new map begins

  bool deform = true;       // the map bends as its deformation graph says; else it is rigid
  int bending_frames = 10;  // from when a bend is worked out to when it is applied
  double bend_again = 2;    // seconds after one that was refused
  // Vision goes with a map that it has just agreed with by up to this, in distances to what is seen
  // and radians; what is farther off is a loop to be closed.
  double largest_correction = 0.1;
  double fusion_silent = 1;  // seconds without a fused pose after which poses go with the map
  // A loop closes no farther from the fused position than three of its sigmas and this, in working
  // distances.
  double loop_gate = 0.1;
};

// What sensor fusion says of a frame.
struct FusedState {
  std::int64_t utime = 0;
  bool is_known = false;    // measured, not merely predicted or still searched for
  bool is_nominal = false;  // by every sensor
  SE3 rig_T_camera;
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();          // metres a second, rig frame
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  // radians a second, camera frame
  // Translation m^2, rig frame; rotation rad^2, camera frame.
  Matrix6d covariance = Matrix6d::Zero();
  std::optional<double> depth_scale;  // that makes depth as it comes metric
};

enum class SlamStatus : std::int8_t { kOk = 0, kDegraded = 1, kLost = 2, kRelocalised = 3 };

struct SlamPose {
  std::int64_t utime = 0;
  SlamStatus status = SlamStatus::kLost;
  int map_version = 0;  // one more whenever the map's relation to the rig was set anew
  std::string cause;    // why it is not kOk; of kRelocalised, where it is not the map that told
  SE3 map_T_camera;     // the last known when kLost
  // Translation m^2, rotation rad^2, camera frame: of the pose in relation to the map's first
  // keyframe, drift since then included. Zero when kLost.
  Matrix6d covariance = Matrix6d::Zero();
  double icp_rms = 0;  // as in TrackingResult
  double rgb_rms = 0;
  double inlier_fraction = 0;
  double depth_scale = 1;
};

// The map's frame is that of the first frame's camera, then the rig's; unless a map was given: then
// it is as it was kept, and the camera is lost until it finds itself there.
class VisualSlam {
 public:
  // Throws std::invalid_argument for options that make no sense.
  explicit VisualSlam(const VisualSlamOptions& options);
  VisualSlam(const VisualSlamOptions& options, KeptMap kept);

  // Where the camera is. utimes ascend. Throws std::invalid_argument when the frame's grid is too
  // small, or not that of the frame that the map began with.
  SlamPose track(const Frame& frame, const PictureHealth& health);
  // The same for a picture of which no frame could be made.
  SlamPose lost(std::int64_t utime, const PictureHealth& health);
  // Merges the frame tracked last into the map; nothing when lost. `fused`: what fusion made of
  // that frame, or of the one that was lost.
  void merge(const std::optional<FusedState>& fused = std::nullopt);

  // The end: what is still being refined is merged as well.
  void settle();

  const SurfelMap& map() const { return map_; }
  MapIncrement take_increment() { return map_.take_increment(); }
  // What has bent the map since the last time, and what was refused.
  std::vector<MapDeformation> take_deformations() { return std::exchange(deformations_, {}); }
  // Keyframes that were found to lie on what was mapped long ago.
  std::int64_t agreements() const { return agreements_; }
  // Why loops were not closed, since the last time.
  std::vector<std::string> take_refusals() { return std::exchange(refusals_, {}); }
  int map_version() const { return map_version_; }
  bool is_in_rig_frame() const { return is_in_rig_frame_; }
  // Another number: the surfels are in another frame, or others, and their ids mean nothing.
  int map_frame() const { return map_frame_; }
  double depth_scale() const { return depth_scale_; }  // that frames' depth is multiplied by
  // What is needed to go on with the map another time.
  KeptMap kept() const;

 private:
  struct Keyframe {
    Frame frame;
    SE3 vision_T_camera;
    std::optional<KeyframePin> pin;
  };
  struct Refinement {
    std::vector<RefinedKeyframe> window;
    std::optional<LoopMatch> match;  // of the newest
  };

  void prepare(const PinholeGrid& grid);
  SE3 predicted_pose(std::int64_t utime) const;
  double usable_share(const Frame& frame) const;
  void begin(const Frame& frame);
  bool begin_again();
  void set_map_aside();
  void use(const FusedState& fused);
  void rebase(const Similarity& rig_S_map);
  std::optional<SE3> fused_pose(std::int64_t utime) const;
  TrackingResult attempt(const Frame& frame, const SE3& start);
  void use_refinement();
  TrackingResult track_near(const Frame& frame, const SE3& start);
  TrackingResult track_from(const Frame& frame, const SE3& start);
  bool confirmed(const Frame& frame, const TrackingResult& result);
  std::optional<TrackingResult> relocalise(const Frame& frame);
  void accept(const Frame& frame, const TrackingResult& result);
  void set_placed(const Frame& frame, const SE3& map_T_camera);
  void forget_thread();
  bool is_blurred(double sharpness);
  bool is_far_from_keyframe() const;
  void refine(const Frame& frame, const SE3& vision_T_camera);
  std::optional<KeyframePin> pin() const;
  std::optional<PlaceGate> gate() const;
  void look_for_loop();
  void learn(const Keyframe& keyframe, const std::optional<LoopMatch>& match);
  bool is_fusion_silent() const;
  void begin_bend(DeformationTask task);
  void use_bend();
  void go_with_map();
  void use_what_is_ready();
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
  int missed_ = 0;                              // frames since then,
  std::optional<std::int64_t> unplaced_since_;  // utime; usable pictures all of them
  double distance_ = 0;                         // metres, median depth
  double sharpness_ = 0;                        // lately
  Matrix6d drift_ = Matrix6d::Zero();           // covariance of reference_, camera frame there

  std::optional<FusedState> fused_;  // of the frame before
  bool is_in_rig_frame_ = false;
  bool is_settled_ = false;  // the rotation into the rig was well known: the map stays
  SE3 rig_T_map_;            // by how much fusion and vision have drifted apart since
  double rebase_below_ = 0;  // rotation's one sigma: so well known, the map is turned (again)
  double depth_scale_ = 1;
  int map_version_ = 0;
  int map_frame_ = 0;
  bool begins_again_ = false;  // with the frame tracked last
  struct Aside {
    SurfelArrays surfels;
    Relocaliser relocaliser;
    MapDeformer deformer;
  };
  std::optional<Aside> aside_;  // in the rig's frame, while the present map is not

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

  // Vision goes on by itself; where it is in the map changes when the map bends.
  SE3 map_T_vision_;
  MapDeformer deformer_;
  std::optional<LoopSearch> loop_search_;     // since the first frame
  std::optional<std::int64_t> agreed_utime_;  // when what was seen last agreed with the old map
  std::optional<std::int64_t> fused_utime_;   // of the last state of fusion's that is known
  bool has_wall_moved_ = false;               // as the keyframe before showed it
  std::int64_t agreements_ = 0;
  int frames_since_bend_ = 0;
  std::int64_t bend_due_ = INT64_MIN;  // utime: none before, as the last one was refused
  std::vector<MapDeformation> deformations_;
  std::vector<std::string> refusals_;
  // After all that they read: they are waited for first.
  std::future<MapDeformation> bending_;
  std::future<Refinement> refining_;
};

}  // namespace gastronaut::slam

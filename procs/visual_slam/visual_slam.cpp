#include "visual_slam/visual_slam.hpp"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

namespace gastronaut::slam {
namespace {

constexpr double kMicrosecond = 1e-6;
constexpr double kLongestPrediction = 0.3;  // seconds that a velocity is trusted
constexpr double kShortestInterval = 2e-3;  // seconds: closer frames tell no velocity
// One sigma of what two ways to the same place may differ by, as a fraction of the working distance
// and in radians: a place that the camera finds itself at twice is the right one.
constexpr double kSamePlace = 0.01;
constexpr double kNearest = 0.01;   // working distances: no camera sees anything so near
constexpr double kBend = 0.05;      // of a surface over five pixels, as a fraction of depth
constexpr double kBeginStd = 1e-5;  // metres, radians: the first frame is where it is said to be
constexpr double kSharpnessMemory = 0.1;  // weight of the newest picture

double median_depth(const Plane<float>& depth) {
  std::vector<float> known;
  std::copy_if(depth.values.begin(), depth.values.end(), std::back_inserter(known),
               [](float value) { return value > 0 && std::isfinite(value); });
  if (known.empty()) return 0;
  const auto middle = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2);
  std::nth_element(known.begin(), middle, known.end());
  return static_cast<double>(*middle);
}

// What a frame taken at the view's pose would be.
Frame frame_of(const ModelView& view) {
  Frame frame;
  frame.grid = view.grid;
  frame.depth = view.depth;
  frame.albedo = view.albedo;
  return frame;
}

ModelView model_of(const Frame& frame, const SE3& map_T_camera) {
  ModelView view;
  view.map_T_camera = map_T_camera;
  view.grid = frame.grid;
  view.depth = frame.depth;
  view.albedo = frame.albedo;
  NormalMap normals;
  estimate_normals(frame.depth, frame.grid, kBend, normals);
  view.normal_x = std::move(normals.x);
  view.normal_y = std::move(normals.y);
  view.normal_z = std::move(normals.z);
  return view;
}

// In distances and radians.
struct Motion {
  double shift = 0;
  double turn = 0;
};
Motion motion(const SE3& a, const SE3& b, double distance) {
  const SE3 between = a.inverse() * b;
  return {distance > 0 ? between.translation.norm() / distance : 0,
          angle_between(between.rotation, Eigen::Quaterniond::Identity())};
}

// The covariance of a twist at `from` as one of the twist at `to` that moves rigidly with it.
Matrix6d transported(const Matrix6d& covariance, const SE3& from, const SE3& to) {
  const Matrix6d adjoint = (to.inverse() * from).adjoint();
  return adjoint * covariance * adjoint.transpose();
}

// Whether the camera may have moved in any direction, and the map would still fit.
bool holds_nothing(const TrackingResult& result, double distance, double hold) {
  if (result.status != TrackingStatus::kDegraded || !(distance > 0)) return false;
  const Eigen::Matrix3d translation = result.covariance.topLeftCorner<3, 3>();
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(translation, Eigen::EigenvaluesOnly);
  return std::sqrt(solver.eigenvalues()(0)) > hold * distance;
}

// One sigma in the worst direction.
double worst_std(const Eigen::Matrix3d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(solver.eigenvalues()(2), 0.0));
}

bool is_trusted(const FusedState& fused, double position_std, double rotation_std) {
  return fused.is_known && worst_std(fused.covariance.topLeftCorner<3, 3>()) <= position_std &&
         worst_std(fused.covariance.bottomRightCorner<3, 3>()) <= rotation_std;
}

void scale_depth(Plane<float>& depth, double scale) {
  for (float& value : depth.values) value *= static_cast<float>(scale);
}

MapDeformerOptions deformer_options(const VisualSlamOptions& options) {
  MapDeformerOptions chosen = options.deformer;
  chosen.working_distance = options.map.working_distance;
  chosen.time_reach = options.map.active_window;
  return chosen;
}

VisualSlamOptions checked(const VisualSlamOptions& options) {
  if (!(options.keyframe_shift > 0) || !(options.keyframe_turn > 0) ||
      options.refinement_frames < 1 || options.candidates < 0) {
    throw std::invalid_argument("visual_slam: keyframes need a shift, a turn and a frame of time");
  }
  return options;
}

}  // namespace

VisualSlam::VisualSlam(const VisualSlamOptions& options)
    : options_(checked(options)),
      map_(options.map),
      rebase_below_(options.rebase_rotation_std),
      deformer_(deformer_options(options)) {}

VisualSlam::VisualSlam(const VisualSlamOptions& options, KeptMap kept)
    : options_(checked(options)),
      map_(options.map, std::move(kept.surfels)),
      kept_viewpoints_(std::move(kept.viewpoints)),
      deformer_(deformer_options(options)) {
  deformer_.restart(map_.surfels());
  is_lost_ = map_.size() > 0;
  is_in_rig_frame_ = is_lost_ && kept.depth_scale > 0;
  is_settled_ = is_in_rig_frame_;
  if (is_in_rig_frame_) depth_scale_ = kept.depth_scale;
  rebase_below_ = is_in_rig_frame_ ? 0 : options_.rebase_rotation_std;
}

SlamPose VisualSlam::track(const Frame& frame, const PictureHealth& health) {
  if (!health.failure.empty()) return lost(frame.utime, health);
  if (!tracker_ || (!has_begun_ && map_.size() == 0 && frame.grid != grid_)) prepare(frame.grid);
  if (frame.grid != grid_) {
    throw std::invalid_argument(fmt::format(
        "a frame of {}x{} pixels, focal length {:.2f}, does not go with the map, which "
        "began with {}x{}, {:.2f}",
        frame.grid.width, frame.grid.height, frame.grid.fx, grid_.width, grid_.height, grid_.fx));
  }
  use_what_is_ready();
  frame_ = frame;
  if (depth_scale_ != 1) scale_depth(frame_.depth, depth_scale_);
  is_sharp_ = !is_blurred(health.sharpness);
  pose_ = {};
  pose_.utime = frame.utime;
  pose_.map_version = map_version_;
  if (map_.size() == 0) {
    begin(frame_);
    return pose_;
  }
  std::optional<TrackingResult> result;
  if (map_T_camera_) pose_.map_T_camera = *map_T_camera_;
  if (const auto fused = missed_ > 0 ? fused_pose(frame.utime) : std::nullopt) {
    result = attempt(frame_, rig_T_map_.inverse() * *fused);
  }
  if (map_T_camera_ && (!result || result->status == TrackingStatus::kLost)) {
    result = attempt(frame_, predicted_pose(frame.utime));
  }
  if (!result || result->status == TrackingStatus::kLost) {
    std::optional<TrackingResult> found = relocalise(frame_);
    if (!found) {
      is_lost_ = true;
      ++missed_;
      if (is_sharp_ && !unplaced_since_) unplaced_since_ = frame.utime;
      if (begin_again()) return pose_;
      pose_.cause =
          result && !result->cause.empty() ? result->cause : "does not find itself in the map";
      if (!is_sharp_) pose_.cause = "blur: " + pose_.cause;
      return pose_;
    }
    result = std::move(found);
    is_lost_ = true;
  }
  accept(frame_, *result);
  return pose_;
}

TrackingResult VisualSlam::attempt(const Frame& frame, const SE3& start) {
  TrackingResult result = is_lost_ ? track_from(frame, start) : track_near(frame, start);
  const Motion moved = motion(start, result.map_T_camera, distance_);
  if (moved.shift > options_.largest_shift || moved.turn > options_.largest_turn) {
    result.status = TrackingStatus::kLost;
    result.cause = fmt::format("jumped by {:.1f} mm and {:.0f} degrees",
                               1e3 * moved.shift * distance_, moved.turn * 180 / M_PI);
  }
  if (holds_nothing(result, distance_, options_.tracker.hold)) {
    result.status = TrackingStatus::kLost;
    result.cause = "nothing in the picture tells where the camera is";
  }
  // Where nothing tells that the camera is still near, a doubtful fit is none.
  if (is_lost_ && !confirmed(frame, result)) result.status = TrackingStatus::kLost;
  return result;
}

SlamPose VisualSlam::lost(std::int64_t utime, const PictureHealth& health) {
  use_what_is_ready();
  pose_ = {};
  pose_.utime = utime;
  pose_.map_version = map_version_;
  if (map_T_camera_) pose_.map_T_camera = *map_T_camera_;
  pose_.cause = health.failure_message.empty() ? health.failure : health.failure_message;
  ++missed_;
  unplaced_since_.reset();
  return pose_;
}

void VisualSlam::merge(const std::optional<FusedState>& fused) {
  fused_ = fused;
  if (fused) fused_utime_ = pose_.utime;
  if (pose_.status == SlamStatus::kLost) return;
  if (fused) use(*fused);
  const bool begins_again = std::exchange(begins_again_, false);
  if (begins_again) map_.give_way(frame_, map_T_vision_ * pose_.map_T_camera);
  const bool is_first = map_.size() == 0 || begins_again;
  const bool is_keyframe = is_first || is_far_from_keyframe();
  const bool is_certain = frame_.relative_std <= options_.certain_depth;
  // A blurred picture is tracked, but has nothing to tell the map.
  if (!is_sharp_ && !is_first) return;
  if (is_keyframe && !newest_) {
    relocaliser_->add(frame_, map_T_vision_ * pose_.map_T_camera);
    has_begun_ = true;
    if (is_certain || !is_held_) {
      // The window takes its keyframes' motions for well tracked.
      anchor(pose_.map_T_camera, pose_.covariance);
      look_for_loop();
    } else {
      refine(frame_, pose_.map_T_camera);
    }
  }
  const double since_merge = static_cast<double>(frame_.utime - merged_utime_) * kMicrosecond;
  if (is_certain || is_first || (!newest_ && since_merge > options_.longest_gap)) {
    scale_depth(frame_.depth, std::pow(pose_.depth_scale, 1 - options_.own_scale));
    merge_as_is(frame_, map_T_vision_ * pose_.map_T_camera);
  }
}

// Before the frame is merged.
void VisualSlam::use(const FusedState& fused) {
  const double turn_std = worst_std(fused.covariance.bottomRightCorner<3, 3>());
  // Fusion knows nothing yet of the scale that a kept map came with.
  const bool is_scale_off = is_in_rig_frame_ && map_version_ > 0 && fused.is_nominal &&
                            fused.depth_scale &&
                            std::abs(*fused.depth_scale / depth_scale_ - 1) > options_.rebase_scale;
  // A keyframe that is being refined belongs to the frame that it began in.
  if (is_held_ && !newest_ && fused.depth_scale && (turn_std <= rebase_below_ || is_scale_off) &&
      is_trusted(fused, options_.rebase_position_std, options_.rebase_rotation_std)) {
    Similarity rig_S_map;
    rig_S_map.scale = *fused.depth_scale / depth_scale_;
    rig_S_map.rotation =
        (fused.rig_T_camera.rotation * pose_.map_T_camera.rotation.conjugate()).normalized();
    rig_S_map.translation =
        fused.rig_T_camera.translation - rig_S_map * pose_.map_T_camera.translation;
    // What was set aside is in its place; it is joined once, and not turned again.
    rebase_below_ = aside_ ? 0 : std::min(rebase_below_, turn_std / 2);
    rebase(rig_S_map);
    is_settled_ = is_settled_ || rebase_below_ == 0 || turn_std <= options_.settled_rotation_std;
    return;
  }
  if (!is_in_rig_frame_) return;
  if (is_trusted(fused, options_.restart_position_std, options_.restart_rotation_std)) {
    rig_T_map_ = fused.rig_T_camera * pose_.map_T_camera.inverse();
  }
}

void VisualSlam::rebase(const Similarity& rig_S_map) {
  const auto scale_covariance = [factors = rig_S_map.twist_factors()](Matrix6d& covariance) {
    covariance = (factors.asDiagonal() * covariance * factors.asDiagonal()).eval();
  };
  // A map that has settled stays, and vision takes its place in it anew: where it has a model of
  // its own, the last keyframe. Where the map itself is the model, vision goes with it.
  if (!is_settled_ || !model_) {
    // The camera is where vision has it; the map comes from where it has that camera.
    const SE3 vision_T_map = map_T_vision_.inverse();
    const Similarity rig_S_bent{rig_S_map.scale, rig_S_map.rotation * vision_T_map.rotation,
                                rig_S_map * vision_T_map.translation};
    map_.transform(rig_S_bent);
    relocaliser_->transform(rig_S_bent);
    deformer_.transform(rig_S_bent, is_in_rig_frame_);
    bending_ = {};  // of a map that was elsewhere
    map_T_vision_ = {};
    ++map_frame_;
  } else {
    // A map that bends keeps the camera where it is in it, until its pins have it elsewhere.
    const SE3 map_T_camera = map_T_vision_ * pose_.map_T_camera;
    map_T_vision_ =
        options_.deform ? map_T_camera * (rig_S_map * pose_.map_T_camera).inverse() : SE3{};
  }
  window_->transform(rig_S_map);
  for (SE3* pose : {&pose_.map_T_camera, &*map_T_camera_, &reference_, &anchor_}) {
    *pose = rig_S_map * *pose;
  }
  for (Matrix6d* covariance : {&pose_.covariance, &drift_, &anchor_covariance_}) {
    scale_covariance(*covariance);
  }
  if (model_) {
    model_->map_T_camera = rig_S_map * model_->map_T_camera;
    scale_depth(model_->depth, rig_S_map.scale);
  }
  velocity_ = rig_S_map.twist_factors().cwiseProduct(velocity_);
  distance_ *= rig_S_map.scale;
  scale_depth(frame_.depth, rig_S_map.scale);
  depth_scale_ *= rig_S_map.scale;
  if (aside_) {
    map_.add(aside_->surfels);
    relocaliser_->add(aside_->relocaliser);
    deformer_.join(std::move(aside_->deformer));
    aside_.reset();
  }
  is_in_rig_frame_ = true;
  rig_T_map_ = {};
  ++map_version_;
}

// Where fusion expects the camera, rig frame. Nothing while it does not know that well, or the map
// is not in that frame.
std::optional<SE3> VisualSlam::fused_pose(std::int64_t utime) const {
  if (!fused_ || !is_in_rig_frame_ ||
      !is_trusted(*fused_, options_.restart_position_std, options_.restart_rotation_std)) {
    return std::nullopt;
  }
  const double ahead = static_cast<double>(utime - fused_->utime) * kMicrosecond;
  if (!(ahead > 0 && ahead <= kLongestPrediction)) return std::nullopt;
  return SE3{fused_->rig_T_camera.rotation * so3_exp(ahead * fused_->angular_velocity),
             fused_->rig_T_camera.translation + ahead * fused_->velocity};
}

// The wall has moved, or the tissue is unknown: a new thread of keyframes in the same map, where
// fusion has the camera.
bool VisualSlam::begin_again() {
  if (!unplaced_since_) return false;
  const double unplaced_for = static_cast<double>(frame_.utime - *unplaced_since_) * kMicrosecond;
  if (unplaced_for < options_.restart_after || !is_sharp_ ||
      usable_share(frame_) < options_.least_depth) {
    return false;
  }
  const std::optional<SE3> fused = fused_pose(frame_.utime);
  SE3 pose;
  if (fused) {
    pose = *fused;
    Matrix6d to_camera = Matrix6d::Identity();
    to_camera.topLeftCorner<3, 3>() = pose.rotation.conjugate().toRotationMatrix();
    pose_.covariance = to_camera * fused_->covariance * to_camera.transpose();
    pose_.cause = "began again at the fused pose";
    velocity_ << to_camera.topLeftCorner<3, 3>() * fused_->velocity, fused_->angular_velocity;
  } else if (fused_ && (is_in_rig_frame_ || aside_) && unplaced_for >= options_.new_map_after) {
    set_map_aside();
    pose_.covariance = kBeginStd * kBeginStd * Matrix6d::Identity();
    pose_.cause = "began a new map: the fused pose is not known well enough";
    velocity_.setZero();
  } else {
    return false;
  }
  if (fused_ && fused_->depth_scale) {
    scale_depth(frame_.depth, *fused_->depth_scale / depth_scale_);
    depth_scale_ = *fused_->depth_scale;
  }
  pose_.status = SlamStatus::kRelocalised;
  pose_.map_T_camera = pose;
  pose_.map_version = ++map_version_;
  pose_.inlier_fraction = 1;
  is_held_ = true;
  forget_thread();
  map_T_vision_ = {};
  anchor(pose, pose_.covariance);
  // Old surfels must not pull the next frames to where they were.
  if (frame_.relative_std > options_.certain_depth) {
    model_ = model_of(frame_, pose);
    refined_points_ = options_.window.points;
  }
  rig_T_map_ = {};
  begins_again_ = true;
  set_placed(frame_, pose);
  return true;
}

// What was begun since the last time is in no known frame, and small: it is forgotten.
void VisualSlam::set_map_aside() {
  forget_thread();
  if (is_in_rig_frame_) aside_ = Aside{map_.surfels(), *relocaliser_, deformer_};
  map_ = SurfelMap(options_.map);
  relocaliser_.emplace(grid_, options_.relocaliser);
  is_in_rig_frame_ = false;
  is_settled_ = false;
  rebase_below_ = options_.rebase_rotation_std / 2;
  deformer_ = MapDeformer(deformer_options(options_));
  ++map_frame_;
}

KeptMap VisualSlam::kept() const {
  if (aside_) return {aside_->surfels, aside_->relocaliser.viewpoints(), depth_scale_};
  return {map_.surfels(), relocaliser_ ? relocaliser_->viewpoints() : kept_viewpoints_,
          is_in_rig_frame_ ? depth_scale_ : 0};
}

void VisualSlam::prepare(const PinholeGrid& grid) {
  FrameTracker tracker(grid, options_.tracker);
  relocaliser_.emplace(grid, options_.relocaliser);
  window_ = std::make_unique<KeyframeWindow>(grid, options_.window);
  for (const SE3& viewpoint : kept_viewpoints_) {
    map_.predict(viewpoint, grid, 0, MapPart::kAll, view_);
    Frame frame = frame_of(view_);
    for (const std::int32_t id : view_.surfel.values) {
      if (id < 0) continue;
      frame.utime = std::max(frame.utime, map_.surfels().updated[static_cast<std::size_t>(id)]);
    }
    relocaliser_->add(frame, viewpoint);
  }
  if (options_.deform) loop_search_.emplace(grid, options_.tracker, options_.loops);
  tracker_ = std::move(tracker);
  grid_ = grid;
}

// Of the picture: with depth that the map can use.
double VisualSlam::usable_share(const Frame& frame) const {
  const double nearest = kNearest * options_.map.working_distance;
  const double farthest = options_.map.farthest * options_.map.working_distance;
  const auto is_within = [&](float value) {
    return static_cast<double>(value) >= nearest && static_cast<double>(value) <= farthest;
  };
  const auto within =
      std::count_if(frame.depth.values.begin(), frame.depth.values.end(), is_within);
  return static_cast<double>(within) / static_cast<double>(frame.depth.size());
}

void VisualSlam::begin(const Frame& frame) {
  const double share = usable_share(frame);
  if (share < options_.least_depth) {
    pose_.cause = fmt::format(
        "too little to begin a map with: {:.0f} % of the picture have depth of {:.2g} to {:.2g} m",
        100 * share, kNearest * options_.map.working_distance,
        options_.map.farthest * options_.map.working_distance);
    return;
  }
  set_placed(frame, {});
  // What a map that has gone again knew of its place is of no use.
  forget_thread();
  map_T_vision_ = {};
  deformer_ = MapDeformer(deformer_options(options_));
  relocaliser_.emplace(grid_, options_.relocaliser);
  if (is_in_rig_frame_) ++map_frame_;
  is_in_rig_frame_ = false;
  is_settled_ = false;
  rebase_below_ = options_.rebase_rotation_std;
  pose_.status = has_begun_ ? SlamStatus::kDegraded : SlamStatus::kOk;
  if (has_begun_) pose_.cause = "no surface was found in what was seen so far";
  pose_.inlier_fraction = 1;
  pose_.covariance = kBeginStd * kBeginStd * Matrix6d::Identity();
  anchor({}, pose_.covariance);
}

SE3 VisualSlam::predicted_pose(std::int64_t utime) const {
  const double ahead = static_cast<double>(utime - utime_) * kMicrosecond;
  if (is_lost_ || ahead > kLongestPrediction) return *map_T_camera_;
  return *map_T_camera_ * SE3::exp(velocity_ * ahead);
}

// What a refined keyframe saw is sharper than what was merged of it, so where depth needs
// refinement it is the model; the merged surfels are, where that does not reach.
TrackingResult VisualSlam::track_near(const Frame& frame, const SE3& start) {
  if (model_) {
    const TrackingResult result = tracker_->track(frame, *model_, start);
    if (result.status == TrackingStatus::kOk) return result;
    const TrackingResult by_surfels = track_from(frame, start);
    return by_surfels.status < result.status ? by_surfels : result;
  }
  return track_from(frame, start);
}

// What was seen long ago is as good as what was seen just now, and seen again it must not be built
// once more.
TrackingResult VisualSlam::track_from(const Frame& frame, const SE3& start) {
  const SE3 map_T_camera = map_T_vision_ * start;
  map_.predict(map_T_camera, frame.grid, frame.utime, MapPart::kAll, view_);
  TrackingResult result = tracker_->track(frame, view_, map_T_camera);
  result.map_T_camera = map_T_vision_.inverse() * result.map_T_camera;
  return result;
}

// Seen from where it says to be, the map must lead to the same place again.
bool VisualSlam::confirmed(const Frame& frame, const TrackingResult& result) {
  if (result.status != TrackingStatus::kOk) return false;
  const TrackingResult again = track_from(frame, result.map_T_camera);
  if (again.status != TrackingStatus::kOk) return false;
  const double distance = median_depth(frame.depth);
  const Motion moved = motion(result.map_T_camera, again.map_T_camera, distance);
  return distance > 0 && moved.shift < kSamePlace && moved.turn < kSamePlace;
}

std::optional<TrackingResult> VisualSlam::relocalise(const Frame& frame) {
  for (const SE3& candidate : relocaliser_->candidates(frame, options_.candidates)) {
    TrackingResult result = track_from(frame, map_T_vision_.inverse() * candidate);
    if (confirmed(frame, result)) return result;
  }
  return std::nullopt;
}

void VisualSlam::accept(const Frame& frame, const TrackingResult& result) {
  pose_.status = result.status == TrackingStatus::kOk ? SlamStatus::kOk : SlamStatus::kDegraded;
  pose_.cause = result.cause;
  is_held_ = result.status == TrackingStatus::kOk;
  if (!is_sharp_) {
    pose_.status = SlamStatus::kDegraded;
    pose_.cause = pose_.cause.empty() ? "blur" : "blur, " + pose_.cause;
  }
  if (model_ && refined_points_ < options_.least_points * options_.window.points) {
    pose_.status = SlamStatus::kDegraded;
    pose_.cause += (pose_.cause.empty() ? "" : ", ") +
                   fmt::format("low texture: {} points hold the last keyframe", refined_points_);
  }
  pose_.map_T_camera = result.map_T_camera;
  pose_.icp_rms = result.icp_rms;
  pose_.rgb_rms = result.rgb_rms;
  pose_.inlier_fraction = result.inlier_fraction;
  pose_.depth_scale = result.depth_scale;
  pose_.covariance = transported(drift_, reference_, result.map_T_camera) + result.covariance;
  const double elapsed = static_cast<double>(frame.utime - utime_) * kMicrosecond;
  if (is_lost_) {
    pose_.status = SlamStatus::kRelocalised;
    pose_.cause.clear();
    velocity_.setZero();
    forget_thread();
    anchor(result.map_T_camera, pose_.covariance);
  } else {
    const Vector6d moved = (map_T_camera_->inverse() * result.map_T_camera).log();
    if (elapsed > kShortestInterval) velocity_ = moved / elapsed;
  }
  set_placed(frame, result.map_T_camera);
}

void VisualSlam::set_placed(const Frame& frame, const SE3& map_T_camera) {
  is_lost_ = false;
  missed_ = 0;
  unplaced_since_.reset();
  map_T_camera_ = map_T_camera;
  utime_ = frame.utime;
  if (const double distance = median_depth(frame.depth); distance > 0) distance_ = distance;
}

// What was seen before has lost its thread to what is seen now.
void VisualSlam::forget_thread() {
  if (refining_.valid()) refining_.wait();
  refining_ = {};
  newest_.reset();
  model_.reset();
  bending_ = {};
  agreed_utime_.reset();
}

bool VisualSlam::is_blurred(double sharpness) {
  if (!(sharpness > 0)) return false;
  if (sharpness_ == 0) sharpness_ = sharpness;
  const bool blurred = sharpness < options_.blur * sharpness_;
  // A camera that stays out of focus is judged by its new standard after a while.
  sharpness_ += kSharpnessMemory * (sharpness - sharpness_);
  return blurred;
}

bool VisualSlam::is_far_from_keyframe() const {
  const Motion moved = motion(reference_, pose_.map_T_camera, distance_);
  return moved.shift > options_.keyframe_shift || moved.turn > options_.keyframe_turn;
}

// A new thread of keyframes begins at a pose of that covariance.
void VisualSlam::anchor(const SE3& map_T_camera, const Matrix6d& covariance) {
  anchor_ = map_T_camera;
  anchor_covariance_ = covariance;
  reference_ = map_T_camera;
  drift_ = covariance;
  window_->clear();
}

void VisualSlam::refine(const Frame& frame, const SE3& vision_T_camera) {
  window_->add(frame, vision_T_camera);
  newest_ = Keyframe{frame, vision_T_camera, pin()};
  reference_ = vision_T_camera;
  frames_since_keyframe_ = 0;
  // Nothing is merged meanwhile.
  refining_ = std::async(std::launch::async, [this, &keyframe = *newest_, gate = gate()] {
    Refinement refinement{window_->refine(), std::nullopt};
    if (options_.deform && refinement.window.size() > 1) {
      const RefinedKeyframe& refined = refinement.window.back();
      Frame seen = keyframe.frame;
      seen.depth = refined.depth;
      seen.relative_std = refined.relative_std;
      refinement.match =
          loop_search_->look(seen, map_T_vision_ * refined.map_T_camera, map_, *relocaliser_, gate);
    }
    return refinement;
  });
}

// Of a keyframe that needs no refinement.
void VisualSlam::look_for_loop() {
  if (!options_.deform || map_.size() == 0 || !is_held_) return;
  const SE3 map_T_camera = map_T_vision_ * pose_.map_T_camera;
  learn({frame_, pose_.map_T_camera, pin()},
        loop_search_->look(frame_, map_T_camera, map_, *relocaliser_, gate()));
}

// Where fusion has the camera, if the map is in place and that is well known.
std::optional<KeyframePin> VisualSlam::pin() const {
  if (!fused_ || fused_->utime != pose_.utime || !is_settled_ || !fused_->is_nominal ||
      !is_trusted(*fused_, options_.restart_position_std, options_.restart_rotation_std)) {
    return std::nullopt;
  }
  return KeyframePin{fused_->rig_T_camera, fused_->covariance};
}

// However well that is known: where a look-alike may be taken for the place, a wide gate is better
// than none.
std::optional<PlaceGate> VisualSlam::gate() const {
  if (!fused_ || fused_->utime != pose_.utime || !fused_->is_known || !is_in_rig_frame_) {
    return std::nullopt;
  }
  constexpr double kSigmas = 3;
  return PlaceGate{fused_->rig_T_camera.translation,
                   kSigmas * worst_std(fused_->covariance.topLeftCorner<3, 3>()) +
                       options_.loop_gate * options_.map.working_distance};
}

// The frames since the keyframe were tracked in relation to where it was thought to be: they move
// with it.
void VisualSlam::use_refinement() {
  if (!newest_ || ++frames_since_keyframe_ < options_.refinement_frames) return;
  const Refinement refinement = refining_.get();
  Keyframe keyframe = *std::exchange(newest_, std::nullopt);
  const RefinedKeyframe& refined = refinement.window.back();
  map_T_camera_ = refined.map_T_camera * (keyframe.vision_T_camera.inverse() * *map_T_camera_);
  reference_ = refined.map_T_camera;
  drift_ = transported(anchor_covariance_, anchor_, reference_) + refined.covariance;
  // The first one has no other to hold it yet, and was merged as it is.
  const bool is_first = refinement.window.size() == 1;
  refined_points_ = is_first ? options_.window.points : refined.points;
  keyframe.frame.depth = refined.depth;
  keyframe.frame.relative_std = refined.relative_std;
  keyframe.vision_T_camera = refined.map_T_camera;
  learn(keyframe, refinement.match);
  if (!is_first) merge_as_is(keyframe.frame, map_T_vision_ * refined.map_T_camera);
  model_ = model_of(keyframe.frame, refined.map_T_camera);
}

// Where a keyframe is in the map, and where the map should be by what it shows. What it saw may be
// the old map's surface in its place. Where it is not in its place, a loop is to be closed; unless
// the two have agreed until now: then vision goes with the map.
void VisualSlam::learn(const Keyframe& keyframe, const std::optional<LoopMatch>& match) {
  if (!options_.deform) return;
  if (match && !match->refusal.empty()) refusals_.push_back(match->refusal);
  const std::int64_t utime = keyframe.frame.utime;
  SE3 map_T_camera = map_T_vision_ * keyframe.vision_T_camera;
  const bool is_found = match && match->is_accepted();
  const bool is_displaced = match && deformer_.is_displaced(map_T_camera, *match);
  const Motion step = match ? motion(map_T_camera, match->map_T_camera, distance_) : Motion{};
  const bool is_near =
      match && !match->is_global && std::max(step.shift, step.turn) <= options_.largest_correction;
  const bool has_agreed =
      agreed_utime_ &&
      static_cast<double>(utime - *agreed_utime_) * kMicrosecond <= options_.map.active_window;
  const bool is_known_surface = is_found && (!is_displaced || (is_near && has_agreed));
  if (is_known_surface && is_displaced) {
    map_T_camera = match->map_T_camera;
    map_T_vision_ = map_T_camera * keyframe.vision_T_camera.inverse();
  }
  // Of a camera that is elsewhere than the match has it, all of the wall is off.
  const bool has_wall_moved = is_near && !match->wall.empty();
  const bool has_it_before = std::exchange(has_wall_moved_, has_wall_moved);
  if (is_known_surface) {
    agreed_utime_ = utime;
    ++agreements_;
  }
  deformer_.add(keyframe.frame, map_T_camera, is_known_surface && !has_wall_moved, keyframe.pin);
  if (bending_.valid() || utime < bend_due_) return;
  if (is_found && !is_known_surface) {
    begin_bend(deformer_.close_loop(map_T_camera, *match, map_.surfels()));
  } else if (has_wall_moved && has_it_before) {
    begin_bend(deformer_.follow_wall(map_T_camera, *match, map_.surfels()));
  } else if (deformer_.is_off_pins()) {
    begin_bend(deformer_.bend_to_pins());
  }
}

void VisualSlam::begin_bend(DeformationTask task) {
  frames_since_bend_ = 0;
  bending_ = std::async(std::launch::async,
                        [task = std::move(task), options = options_.deformer.solver]() mutable {
                          return solve(std::move(task), options);
                        });
}

// Not while a keyframe is being refined: that one is thought to be where the map was.
void VisualSlam::use_bend() {
  if (!bending_.valid() || ++frames_since_bend_ < options_.bending_frames || newest_) return;
  MapDeformation bend = bending_.get();
  if (bend.report.is_accepted()) {
    map_.deform(bend.graph);
    relocaliser_->deform(bend.graph);
    map_T_vision_ = deformer_.follow(bend) * map_T_vision_;
    if (is_fusion_silent()) ++map_version_;
  } else {
    bend_due_ = bend.utime + std::llround(options_.bend_again / kMicrosecond);
  }
  bend.map_version = map_version_;
  deformations_.push_back(std::move(bend));
}

void VisualSlam::use_what_is_ready() {
  use_refinement();
  use_bend();
  // A keyframe that is being refined stays where it began.
  if (!newest_ && is_fusion_silent()) go_with_map();
}

bool VisualSlam::is_fusion_silent() const {
  return !fused_utime_ ||
         static_cast<double>(pose_.utime - *fused_utime_) * kMicrosecond > options_.fusion_silent;
}

void VisualSlam::settle() {
  frames_since_keyframe_ = options_.refinement_frames;
  use_refinement();
  frames_since_bend_ = options_.bending_frames;
  use_bend();
}

void VisualSlam::merge_as_is(const Frame& frame, const SE3& map_T_camera) {
  if (refining_.valid()) refining_.wait();  // it reads the map
  map_.predict(map_T_camera, frame.grid, frame.utime, MapPart::kAll, view_);
  map_.fuse(frame, view_);
  merged_utime_ = std::max(merged_utime_, frame.utime);
}

// Where no fusion makes up for vision's drift, what the map knows better counts.
void VisualSlam::go_with_map() {
  if (map_T_vision_.translation.isZero(0) && map_T_vision_.rotation.vec().isZero(0)) return;
  const Similarity map_S_vision{1, map_T_vision_.rotation, map_T_vision_.translation};
  window_->transform(map_S_vision);
  for (SE3* pose : {&reference_, &anchor_}) *pose = map_T_vision_ * *pose;
  if (map_T_camera_) *map_T_camera_ = map_T_vision_ * *map_T_camera_;
  if (model_) model_->map_T_camera = map_T_vision_ * model_->map_T_camera;
  rig_T_map_ = rig_T_map_ * map_T_vision_.inverse();
  map_T_vision_ = {};
}

}  // namespace gastronaut::slam

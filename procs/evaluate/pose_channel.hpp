// What one pose channel of a log says, against the ground truth.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "evaluate/metrics.hpp"
#include "evaluate/trajectory.hpp"
#include "geometry/se3.hpp"
#include "process/pose_status.hpp"

namespace gastronaut::evaluation {

enum class PoseKind {
  kMagnet,       // 5-DoF rig_T_magnet, the rotation about the magnet's z axis being arbitrary;
                 // covariance: position, two rotations about perpendicular_basis(axis)
  kCameraInRig,  // rig_T_camera; covariance: translation (rig frame), rotation (camera frame)
  kCameraInMap,  // map_T_camera, compared after SE(3) alignment, each map frame by itself;
                 // covariance: translation and rotation, both in the camera frame
};

struct PoseFix {
  std::int64_t utime = 0;                  // microseconds
  std::int8_t status = 0;                  // index into the channel's statuses
  SE3 pose;                                // NaN where the message held none
  Matrix6d covariance = Matrix6d::Zero();  // the channel's degrees of freedom, top left
  std::int32_t frame = 0;  // map_version: a new one says that the map's frame has changed
};

// A column that belongs to the channel but not to poses: residuals, background and the like.
struct ExtraSeries {
  const char* name;
  std::vector<double> values;  // one a fix
};

struct PoseChannel {
  std::string name;
  PoseKind kind = PoseKind::kCameraInRig;
  int covariance_size = 0;  // 0: the channel carries none
  std::vector<PoseStatus> statuses;
  std::vector<PoseFix> fixes;
  std::vector<ExtraSeries> extras;

  bool usable(const PoseFix& fix) const;
  // The frame of most of the usable fixes; 0 for none.
  std::int32_t main_frame() const;
};

struct FixErrors {
  std::optional<SE3> truth;  // of what the channel tells: camera or magnet, in the rig frame
  SE3 aligned;               // the fix in the rig frame
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // estimate minus truth, metres, rig frame
  double rotation = 0;                                 // radians; of the axis for a magnet
  std::optional<double> normalised_squared;            // NEES
};

struct PoseEvaluation {
  std::vector<FixErrors> fixes;  // one a fix; meaningful where truth is known and the pose finite
  // The usable fixes, unaligned, for ATE and RPE; where the map's frame has changed, in the main
  // one.
  MatchedTrajectory usable;
  std::vector<std::int32_t> usable_frames;  // map frame of each usable fix
  std::size_t frames = 0;                   // of the usable fixes
  double availability = 0;                  // share of the truth's span, 0..1
};

// `camera_T_target` is the identity but for a magnet.
PoseEvaluation evaluate_pose_channel(const PoseChannel& channel, const TruthTrack& truth,
                                     const SE3& camera_T_target);

// The usable fixes with truth, cut wherever the map's frame changes: what one frame says of motion
// across its end is nothing.
std::vector<MatchedTrajectory> parts_within_frames(const PoseEvaluation& evaluation);

// Of ascending utimes; 0 for fewer than two.
std::int64_t median_interval(const std::vector<std::int64_t>& utimes);

// Share of the time from `first` to `last` with a usable fix at most three quarters of the
// channel's median interval away. utimes ascending.
double availability(const std::vector<std::int64_t>& usable_utimes, std::int64_t median_interval,
                    std::int64_t first, std::int64_t last);

void set_pose_metrics(Metrics& metrics, const PoseChannel& channel,
                      const PoseEvaluation& evaluation);

}  // namespace gastronaut::evaluation

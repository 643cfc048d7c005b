// What came out of one run over a recording, and how far from the truth that is.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "evaluate/trajectory_errors.hpp"
#include "geometry/se3.hpp"

namespace gastronaut::slam {

enum class TrialStatus { kOk, kDegraded, kLost };

struct Estimate {
  std::int64_t utime = 0;  // of the run, which may be mirrored
  TrialStatus status = TrialStatus::kLost;
  std::string cause;
  SE3 map_T_camera;
  std::optional<Matrix6d> covariance;  // translation m^2, rotation rad^2, camera frame
  double depth_scale = 1;
  double inlier_fraction = 0;
  double track_ms = 0;
  std::optional<double> merge_ms;
  std::optional<SE3> rig_T_camera;  // the truth
};

struct Trial {
  std::string method;
  std::size_t start = 0;  // number of the first frame in the recording
  bool backwards = false;
  std::vector<Estimate> estimates;  // one a frame
};

struct ScoreOptions {
  double working_distance = 0.05;  // metres
  // Of the frames' errors when failures are looked for. Sim(3) where depth itself may have another
  // scale, which is its maker's failure and not tracking's.
  evaluation::AlignmentKind alignment = evaluation::AlignmentKind::kSe3;
  evaluation::Delta path = {0.005, evaluation::DeltaUnit::kMetres};
  evaluation::Delta angle = {5, evaluation::DeltaUnit::kDegrees};
};

// A frame that was not reported as lost is a silent failure when it is further than this from
// where it belongs, by the poses before it; and so is a whole run that reports nothing and is this
// far off. In working distances: 3 mm and 1 mm in a stomach.
inline constexpr double kSilentFrame = 0.06;
inline constexpr double kSilentRun = 0.02;

struct FrameErrors {
  double ate_se3 = 0;  // metres, after the run's alignment
  double ate_sim3 = 0;
  std::optional<double> from_before;  // metres, after alignment of the poses before
  std::optional<double> nees;         // of the motion from the frame before
};

struct TrialScores {
  std::size_t frames = 0;
  double path = 0;     // metres, true
  double ate_se3 = 0;  // metres, RMSE
  double ate_sim3 = 0;
  double scale = 1;      // of Sim(3): what the estimate must be multiplied by
  double rpe_path = 0;   // metres, RMSE, over ScoreOptions::path
  double rpe_angle = 0;  // radians, RMSE, over ScoreOptions::angle
  double drift = 0;      // of the last pose, after alignment of the first; fraction of the path
  std::size_t lost = 0;
  std::size_t degraded = 0;
  std::size_t silent_frames = 0;
  bool failed_silently = false;
  double nees_mean = 0;  // of motions from frame to frame, 6 where covariances are right
  double nees_median = 0;
  double track_ms_median = 0;
  double track_ms_p99 = 0;
  double merge_ms_median = 0;
  double merge_ms_p99 = 0;
  std::vector<std::optional<FrameErrors>> errors;  // one a frame; nothing: lost, or no truth
};

// Not-a-number where nothing can be said.
TrialScores score(const Trial& trial, const ScoreOptions& options);

}  // namespace gastronaut::slam

#include "bench/visual_slam/trial_scores.hpp"

#include <Eigen/SVD>
#include <cmath>

#include "evaluate/consistency.hpp"

namespace gastronaut::slam {
namespace {

using evaluation::AlignmentKind;
using evaluation::MatchedTrajectory;

// Poses needed before a frame's place can be told from them.
constexpr std::size_t kLeastBefore = 5;
// With pairs from every pose: how far their length may be off.
constexpr double kPairTolerance = 0.3;

// Where poses belong by those before them: rotations and positions averaged, so that it is steady
// however short the path was.
class PlaceByThoseBefore {
 public:
  std::optional<SE3> rig_T_map() const {
    if (count_ < kLeastBefore) return std::nullopt;
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(rotations_,
                                                Eigen::ComputeFullU | Eigen::ComputeFullV);
    const Eigen::Matrix3d product = svd.matrixU() * svd.matrixV().transpose();
    const Eigen::Vector3d signs(1, 1, product.determinant());
    const Eigen::Matrix3d rotation = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
    const auto count = static_cast<double>(count_);
    return SE3{Eigen::Quaterniond(rotation), (true_sum_ - rotation * estimated_sum_) / count};
  }
  void add(const SE3& rig_T_camera, const SE3& map_T_camera) {
    rotations_ += (rig_T_camera.rotation * map_T_camera.rotation.inverse()).toRotationMatrix();
    true_sum_ += rig_T_camera.translation;
    estimated_sum_ += map_T_camera.translation;
    ++count_;
  }

 private:
  Eigen::Matrix3d rotations_ = Eigen::Matrix3d::Zero();
  Eigen::Vector3d true_sum_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d estimated_sum_ = Eigen::Vector3d::Zero();
  std::size_t count_ = 0;
};

// Both errors are against the map and taken as independent: with exp on the right,
// P = P_i + A P_(i-1) A^T, A the adjoint of the motion back.
std::optional<double> motion_nees(const Estimate& before, const Estimate& now) {
  if (!before.covariance || !now.covariance) return std::nullopt;
  const SE3 motion = before.map_T_camera.inverse() * now.map_T_camera;
  const SE3 true_motion = before.rig_T_camera->inverse() * *now.rig_T_camera;
  const Matrix6d back = motion.inverse().adjoint();
  return evaluation::normalised_error_squared(
      (true_motion.inverse() * motion).log(),
      *now.covariance + back * *before.covariance * back.transpose());
}

double median(const std::vector<double>& values) { return evaluation::quantile(values, 0.5); }
double p99(const std::vector<double>& values) { return evaluation::quantile(values, 0.99); }

double true_path(const Trial& trial) {
  double path = 0;
  const SE3* before = nullptr;
  for (const Estimate& estimate : trial.estimates) {
    if (!estimate.rig_T_camera) continue;
    if (before != nullptr) {
      path += (estimate.rig_T_camera->translation - before->translation).norm();
    }
    before = &*estimate.rig_T_camera;
  }
  return path;
}

bool usable(const Estimate& estimate) {
  return estimate.status != TrialStatus::kLost && estimate.rig_T_camera.has_value();
}

MatchedTrajectory matched_poses(const Trial& trial) {
  MatchedTrajectory matched;
  for (const Estimate& estimate : trial.estimates) {
    if (!usable(estimate)) continue;
    matched.estimate.utimes.push_back(estimate.utime);
    matched.estimate.poses.push_back(to_pose(estimate.map_T_camera));
    matched.truth.emplace_back(to_pose(*estimate.rig_T_camera));
  }
  return matched;
}

evaluation::RelativeErrors errors_over(const MatchedTrajectory& matched,
                                       const evaluation::Delta& delta) {
  return evaluation::relative_errors(
      matched, evaluation::select_pairs(matched, {delta, true, true, kPairTolerance}));
}

void score_times(const Trial& trial, TrialScores& scores) {
  std::vector<double> track;
  std::vector<double> merge;
  for (std::size_t i = 1; i < trial.estimates.size(); ++i) {  // nothing is tracked in the first
    track.push_back(trial.estimates[i].track_ms);
    if (trial.estimates[i].merge_ms) merge.push_back(*trial.estimates[i].merge_ms);
  }
  scores.track_ms_median = median(track);
  scores.track_ms_p99 = p99(track);
  scores.merge_ms_median = median(merge);
  scores.merge_ms_p99 = p99(merge);
}

double end_drift(const MatchedTrajectory& matched, double path) {
  const Pose motion = matched.estimate.poses.front().inverse() * matched.estimate.poses.back();
  const Pose true_motion = matched.truth.front()->inverse() * *matched.truth.back();
  return (motion.translation - true_motion.translation).norm() / path;
}

// Errors of each frame, failures and NEES.
void score_frames(const Trial& trial, const std::vector<double>& se3,
                  const std::vector<double>& sim3, const ScoreOptions& options,
                  TrialScores& scores) {
  const double scale = options.alignment == AlignmentKind::kSim3 ? scores.scale : 1;
  PlaceByThoseBefore before;
  std::vector<double> nees;
  scores.errors.resize(trial.estimates.size());
  for (std::size_t i = 0, row = 0; i < trial.estimates.size(); ++i) {
    const Estimate& estimate = trial.estimates[i];
    if (!usable(estimate)) continue;
    FrameErrors& errors = scores.errors[i].emplace();
    errors.ate_se3 = se3[row];
    errors.ate_sim3 = sim3[row++];
    SE3 pose = estimate.map_T_camera;
    pose.translation *= scale;
    if (const auto rig_T_map = before.rig_T_map()) {
      errors.from_before =
          (*rig_T_map * pose.translation - estimate.rig_T_camera->translation).norm();
    }
    if (errors.from_before > kSilentFrame * options.working_distance) {
      ++scores.silent_frames;
    } else {
      before.add(*estimate.rig_T_camera, pose);
    }
    if (i > 0 && usable(trial.estimates[i - 1])) {
      errors.nees = motion_nees(trial.estimates[i - 1], estimate);
      if (errors.nees) nees.push_back(*errors.nees);
    }
  }
  scores.nees_mean = evaluation::statistics(nees).mean;
  scores.nees_median = median(nees);
}

}  // namespace

TrialScores score(const Trial& trial, const ScoreOptions& options) {
  TrialScores scores;
  scores.frames = trial.estimates.size();
  scores.path = true_path(trial);
  for (const Estimate& estimate : trial.estimates) {
    scores.lost += estimate.status == TrialStatus::kLost ? 1 : 0;
    scores.degraded += estimate.status == TrialStatus::kDegraded ? 1 : 0;
  }
  score_times(trial, scores);
  const MatchedTrajectory matched = matched_poses(trial);
  const auto sim3 = evaluation::align(matched, AlignmentKind::kSim3);
  const auto errors_se3 =
      evaluation::absolute_errors(matched, evaluation::align(matched, AlignmentKind::kSe3));
  const auto errors_sim3 = evaluation::absolute_errors(matched, sim3);
  scores.ate_se3 = evaluation::statistics(errors_se3).rmse;
  scores.ate_sim3 = evaluation::statistics(errors_sim3).rmse;
  scores.scale = sim3.scale;
  scores.rpe_path = evaluation::statistics(errors_over(matched, options.path).translation).rmse;
  scores.rpe_angle = evaluation::statistics(errors_over(matched, options.angle).rotation).rmse;
  scores.drift = matched.truth.empty() ? std::nan("") : end_drift(matched, scores.path);
  score_frames(trial, errors_se3, errors_sim3, options, scores);
  const double ate = options.alignment == AlignmentKind::kSim3 ? scores.ate_sim3 : scores.ate_se3;
  scores.failed_silently =
      scores.silent_frames > 0 ||
      (scores.lost + scores.degraded == 0 && ate > kSilentRun * options.working_distance);
  return scores;
}

}  // namespace gastronaut::slam

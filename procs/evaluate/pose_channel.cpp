#include "evaluate/pose_channel.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "evaluate/consistency.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr double kDegreesPerRadian = 180 / std::numbers::pi;

Eigen::Vector3d axis_of(const SE3& rig_T_magnet) {
  return rig_T_magnet.rotation * Eigen::Vector3d::UnitZ();
}

// The shortest rotation that takes one unit vector to another.
Eigen::Quaterniond rotation_between(const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
  return Eigen::Quaterniond::FromTwoVectors(from, to);
}

// Estimate minus truth in the coordinates of the channel's covariance.
Eigen::VectorXd error_coordinates(PoseKind kind, const SE3& estimate, const SE3& truth) {
  if (kind == PoseKind::kMagnet) {
    const Eigen::Vector3d axis = axis_of(estimate);
    const Eigen::Vector3d rotation = so3_log(rotation_between(axis_of(truth), axis));
    Vector5d error;
    error << estimate.translation - truth.translation,
        perpendicular_basis(axis).transpose() * rotation;
    return error;
  }
  Vector6d error;
  error << estimate.translation - truth.translation,
      so3_log(truth.rotation.conjugate() * estimate.rotation);
  if (kind == PoseKind::kCameraInMap) {
    error.head<3>() = (truth.rotation.conjugate() * error.head<3>()).eval();
  }
  return error;
}

// The pose as relative errors need it: the roll that no magnet can tell is taken from the truth.
Pose comparable_pose(PoseKind kind, const SE3& estimate, const std::optional<SE3>& truth) {
  if (kind != PoseKind::kMagnet || !truth) return to_pose(estimate);
  const Eigen::Quaterniond tilt = rotation_between(axis_of(*truth), axis_of(estimate));
  return to_pose({tilt * truth->rotation, estimate.translation});
}

// By map frame, where SE(3) alignment puts it. `frames`: one a pose of `usable`.
std::map<std::int32_t, SE3> place_frames(const MatchedTrajectory& usable,
                                         const std::vector<std::int32_t>& frames) {
  std::map<std::int32_t, MatchedTrajectory> parts;
  for (std::size_t i = 0; i < frames.size(); ++i) {
    MatchedTrajectory& part = parts[frames[i]];
    part.estimate.utimes.push_back(usable.estimate.utimes[i]);
    part.estimate.poses.push_back(usable.estimate.poses[i]);
    part.truth.push_back(usable.truth[i]);
  }
  std::map<std::int32_t, SE3> places;
  for (const auto& [frame, part] : parts) {
    const Pose placed = align(part, AlignmentKind::kSe3).truth_T_estimate;
    places[frame] = {Eigen::Quaterniond(placed.rotation), placed.translation};
  }
  return places;
}

}  // namespace

std::int32_t PoseChannel::main_frame() const {
  std::map<std::int32_t, std::size_t> counts;
  for (const PoseFix& fix : fixes) {
    if (usable(fix)) ++counts[fix.frame];
  }
  const auto most =
      std::max_element(counts.begin(), counts.end(),
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  return most == counts.end() ? 0 : most->first;
}

bool PoseChannel::usable(const PoseFix& fix) const {
  return fix.status >= 0 && static_cast<std::size_t>(fix.status) < statuses.size() &&
         statuses[static_cast<std::size_t>(fix.status)].usable && is_finite(fix.pose);
}

std::int64_t median_interval(const std::vector<std::int64_t>& utimes) {
  if (utimes.size() < 2) return 0;
  std::vector<std::int64_t> intervals;
  for (std::size_t i = 1; i < utimes.size(); ++i) intervals.push_back(utimes[i] - utimes[i - 1]);
  const auto middle = intervals.begin() + static_cast<std::ptrdiff_t>(intervals.size() / 2);
  std::nth_element(intervals.begin(), middle, intervals.end());
  return *middle;
}

double availability(const std::vector<std::int64_t>& usable_utimes, std::int64_t median_interval,
                    std::int64_t first, std::int64_t last) {
  if (last <= first) return 0;
  const std::int64_t reach = median_interval * 3 / 4;
  std::int64_t covered = 0;
  std::int64_t covered_until = first;
  for (const std::int64_t utime : usable_utimes) {
    const std::int64_t begin = std::max(covered_until, utime - reach);
    const std::int64_t end = std::min(last, utime + reach);
    if (end <= begin) continue;
    covered += end - begin;
    covered_until = end;
  }
  return static_cast<double>(covered) / static_cast<double>(last - first);
}

PoseEvaluation evaluate_pose_channel(const PoseChannel& channel, const TruthTrack& truth,
                                     const SE3& camera_T_target) {
  PoseEvaluation result;
  result.fixes.resize(channel.fixes.size());
  std::vector<std::int64_t> all_utimes;
  std::vector<std::int32_t>& frames = result.usable_frames;
  for (std::size_t i = 0; i < channel.fixes.size(); ++i) {
    const PoseFix& fix = channel.fixes[i];
    FixErrors& errors = result.fixes[i];
    all_utimes.push_back(fix.utime);
    errors.aligned = fix.pose;
    if (!is_finite(fix.pose)) continue;
    if (const auto rig_T_camera = truth.at(fix.utime)) {
      errors.truth = *rig_T_camera * camera_T_target;
    }
    if (!channel.usable(fix)) continue;
    frames.push_back(fix.frame);
    result.usable.estimate.utimes.push_back(fix.utime);
    result.usable.estimate.poses.push_back(comparable_pose(channel.kind, fix.pose, errors.truth));
    result.usable.truth.push_back(errors.truth ? std::optional(to_pose(*errors.truth))
                                               : std::nullopt);
  }
  if (!truth.empty()) {
    result.availability = availability(result.usable.estimate.utimes, median_interval(all_utimes),
                                       truth.first(), truth.last());
  }
  std::map<std::int32_t, SE3> rig_T_frame;
  if (channel.kind == PoseKind::kCameraInMap) {
    rig_T_frame = place_frames(result.usable, frames);
    const std::int32_t main = channel.main_frame();
    for (std::size_t i = 0; i < frames.size(); ++i) {
      if (frames[i] == main) continue;
      Pose& pose = result.usable.estimate.poses[i];
      pose = to_pose(rig_T_frame[main].inverse() * rig_T_frame[frames[i]]) * pose;
    }
    result.frames = rig_T_frame.size();
  }
  for (std::size_t i = 0; i < channel.fixes.size(); ++i) {
    FixErrors& errors = result.fixes[i];
    if (!is_finite(errors.aligned)) continue;
    const auto place = rig_T_frame.find(channel.fixes[i].frame);
    if (place != rig_T_frame.end()) errors.aligned = place->second * errors.aligned;
    if (!errors.truth) continue;
    const Eigen::VectorXd coordinates =
        error_coordinates(channel.kind, errors.aligned, *errors.truth);
    errors.position = errors.aligned.translation - errors.truth->translation;
    errors.rotation = coordinates.tail(coordinates.size() - 3).norm();
    if (channel.covariance_size > 0) {
      errors.normalised_squared = normalised_error_squared(
          coordinates, channel.fixes[i].covariance.topLeftCorner(channel.covariance_size,
                                                                 channel.covariance_size));
    }
  }
  return result;
}

std::vector<MatchedTrajectory> parts_within_frames(const PoseEvaluation& evaluation) {
  const MatchedTrajectory& usable = evaluation.usable;
  std::vector<MatchedTrajectory> parts;
  std::optional<std::int32_t> frame;
  for (std::size_t i = 0; i < usable.estimate.size(); ++i) {
    if (!usable.truth[i]) continue;
    if (frame != evaluation.usable_frames[i]) parts.emplace_back();
    frame = evaluation.usable_frames[i];
    parts.back().estimate.utimes.push_back(usable.estimate.utimes[i]);
    parts.back().estimate.poses.push_back(usable.estimate.poses[i]);
    parts.back().truth.push_back(usable.truth[i]);
  }
  return parts;
}

void set_pose_metrics(Metrics& metrics, const PoseChannel& channel,
                      const PoseEvaluation& evaluation) {
  const std::string& name = channel.name;
  metrics.set_count(name + ".count", channel.fixes.size());
  metrics.set_count(name + ".usable", evaluation.usable.estimate.size());
  const MatchedTrajectory matched = evaluation.usable.only_matched();
  metrics.set_count(name + ".with_truth", matched.estimate.size());
  metrics.set(name + ".availability", evaluation.availability);
  if (evaluation.frames > 1) metrics.set_count(name + ".map_frames", evaluation.frames);
  set_absolute_errors(metrics, name + ".ate", matched);
  const std::vector<MatchedTrajectory> parts = parts_within_frames(evaluation);
  for (const char* text :
       {"1frames", "1s", "2mm", "5mm", "10mm", "20mm", "50mm", "100mm", "5deg"}) {
    const PairSelection selection{parse_delta(text), true, true};
    set_relative_errors(metrics, name + ".rpe." + text, parts, selection);
  }

  std::vector<double> rotation;
  std::vector<double> components[3];
  std::vector<double> normalised;
  for (std::size_t i = 0; i < channel.fixes.size(); ++i) {
    const FixErrors& errors = evaluation.fixes[i];
    if (!errors.truth || !channel.usable(channel.fixes[i])) continue;
    rotation.push_back(errors.rotation);
    for (int axis = 0; axis < 3; ++axis) components[axis].push_back(errors.position[axis]);
    if (errors.normalised_squared) normalised.push_back(*errors.normalised_squared);
  }
  metrics.set_statistics(
      name + (channel.kind == PoseKind::kMagnet ? ".axis_error_deg" : ".rotation_error_deg"),
      rotation, kDegreesPerRadian);
  constexpr const char* kAxisNames[3] = {"x", "y", "z"};
  for (int axis = 0; axis < 3; ++axis) {
    metrics.set_statistics(name + ".error." + kAxisNames[axis], components[axis]);
  }
  if (!normalised.empty()) {
    const Consistency nees = consistency(normalised, channel.covariance_size);
    metrics.set_count(name + ".nees.count", nees.count);
    metrics.set_count(name + ".nees.degrees_of_freedom",
                      static_cast<std::size_t>(channel.covariance_size));
    metrics.set(name + ".nees.mean", nees.mean);
    metrics.set(name + ".nees.median", nees.median);
    metrics.set(name + ".nees.band_low", nees.band_low);
    metrics.set(name + ".nees.band_high", nees.band_high);
    metrics.set(name + ".nees.share_inside", nees.share_inside);
  }
  for (std::size_t status = 0; status < channel.statuses.size(); ++status) {
    const std::string key = name + ".status." + channel.statuses[status].name;
    std::size_t count = 0;
    std::vector<double> errors;
    for (std::size_t i = 0; i < channel.fixes.size(); ++i) {
      if (channel.fixes[i].status != static_cast<std::int8_t>(status)) continue;
      ++count;
      if (evaluation.fixes[i].truth) errors.push_back(evaluation.fixes[i].position.norm());
    }
    metrics.set_count(key + ".count", count);
    metrics.set_statistics(key + ".position", errors);
  }
  for (const ExtraSeries& extra : channel.extras) {
    std::vector<double> values;
    for (std::size_t i = 0; i < extra.values.size(); ++i) {
      if (channel.usable(channel.fixes[i]) && std::isfinite(extra.values[i])) {
        values.push_back(extra.values[i]);
      }
    }
    if (!values.empty()) metrics.set(name + "." + extra.name + ".median", quantile(values, 0.5));
  }
}

}  // namespace gastronaut::evaluation

#include "evaluate/trajectory.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <string>
#include <tuple>

namespace gastronaut::evaluation {

double rotation_angle(const Eigen::Matrix3d& rotation) {
  const Eigen::Vector3d twice_sine(rotation(2, 1) - rotation(1, 2), rotation(0, 2) - rotation(2, 0),
                                   rotation(1, 0) - rotation(0, 1));
  return std::atan2(twice_sine.norm(), rotation.trace() - 1);
}

std::size_t MatchedTrajectory::count_matched() const {
  return static_cast<std::size_t>(
      std::count_if(truth.begin(), truth.end(), [](const auto& pose) { return pose.has_value(); }));
}

MatchedTrajectory MatchedTrajectory::only_matched() const {
  MatchedTrajectory result;
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    if (!truth[i]) continue;
    result.estimate.utimes.push_back(estimate.utimes[i]);
    result.estimate.poses.push_back(estimate.poses[i]);
    result.truth.push_back(truth[i]);
  }
  return result;
}

MatchedTrajectory match(const Trajectory& estimate, const Trajectory& truth,
                        std::int64_t max_difference) {
  std::vector<std::tuple<std::int64_t, std::size_t, std::size_t>> candidates;
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    const std::int64_t utime = estimate.utimes[i];
    auto nearby =
        std::upper_bound(truth.utimes.begin(), truth.utimes.end(), utime - max_difference);
    for (; nearby != truth.utimes.end() && *nearby < utime + max_difference; ++nearby) {
      candidates.emplace_back(std::abs(*nearby - utime),
                              static_cast<std::size_t>(nearby - truth.utimes.begin()), i);
    }
  }
  std::sort(candidates.begin(), candidates.end());
  MatchedTrajectory result{estimate, std::vector<std::optional<Pose>>(estimate.size())};
  std::vector<bool> taken(truth.size());
  for (const auto& [difference, truth_index, estimate_index] : candidates) {
    if (taken[truth_index] || result.truth[estimate_index]) continue;
    taken[truth_index] = true;
    result.truth[estimate_index] = truth.poses[truth_index];
  }
  return result;
}

MatchedTrajectory match_by_index(const Trajectory& estimate, const Trajectory& truth) {
  if (estimate.size() != truth.size()) {
    throw std::invalid_argument("the estimate has " + std::to_string(estimate.size()) +
                                " poses, the ground truth " + std::to_string(truth.size()) +
                                "; without times they must have the same number");
  }
  return {estimate, {truth.poses.begin(), truth.poses.end()}};
}

void TruthTrack::add(std::int64_t utime, const SE3& pose) {
  if (!utimes_.empty() && utime <= utimes_.back()) return;
  utimes_.push_back(utime);
  poses_.push_back(pose);
}

std::optional<SE3> TruthTrack::at(std::int64_t utime) const {
  const auto after = std::lower_bound(utimes_.begin(), utimes_.end(), utime);
  if (after == utimes_.end()) return std::nullopt;
  const auto index = static_cast<std::size_t>(after - utimes_.begin());
  if (*after == utime) return poses_[index];
  if (index == 0 || *after - utimes_[index - 1] > kMaxGap) return std::nullopt;
  const double fraction = static_cast<double>(utime - utimes_[index - 1]) /
                          static_cast<double>(*after - utimes_[index - 1]);
  return interpolate(poses_[index - 1], poses_[index], fraction);
}

}  // namespace gastronaut::evaluation

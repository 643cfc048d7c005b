// How an estimated trajectory is matched with its ground truth.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "geometry/se3.hpp"
#include "trajectory/stamped_poses.hpp"

namespace gastronaut::evaluation {

// Angle of a rotation matrix in radians, 0..pi, exact for small angles too.
double rotation_angle(const Eigen::Matrix3d& rotation);

using Trajectory = StampedPoses;

// An estimate, and for each of its poses the true one where it is known.
struct MatchedTrajectory {
  Trajectory estimate;
  std::vector<std::optional<Pose>> truth;

  std::size_t count_matched() const;
  // Without the poses whose truth is not known.
  MatchedTrajectory only_matched() const;
};

// Pairs poses whose times differ by less than max_difference (microseconds), nearest pairs first,
// each pose used once: the TUM RGB-D benchmark's rule.
MatchedTrajectory match(const Trajectory& estimate, const Trajectory& truth,
                        std::int64_t max_difference);

// Pose n belongs to pose n; both must have the same size (std::invalid_argument).
MatchedTrajectory match_by_index(const Trajectory& estimate, const Trajectory& truth);

// Ground truth at any time between its samples.
class TruthTrack {
 public:
  // Samples come in order of utime; what does not is ignored.
  void add(std::int64_t utime, const SE3& pose);
  // Constant twist between the samples around utime; nothing outside the span, or where these two
  // are further apart than kMaxGap.
  std::optional<SE3> at(std::int64_t utime) const;

  bool empty() const { return utimes_.empty(); }
  std::size_t size() const { return utimes_.size(); }
  std::int64_t first() const { return utimes_.front(); }
  std::int64_t last() const { return utimes_.back(); }
  const std::vector<std::int64_t>& utimes() const { return utimes_; }
  const std::vector<SE3>& poses() const { return poses_; }

  static constexpr std::int64_t kMaxGap = 200000;  // microseconds

 private:
  std::vector<std::int64_t> utimes_;
  std::vector<SE3> poses_;
};

}  // namespace gastronaut::evaluation

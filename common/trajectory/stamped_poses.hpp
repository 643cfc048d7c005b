// Trajectories as sequences of stamped poses.
//
// Rotations stay matrices, as trajectory files give them: turning a rounded matrix into a unit
// quaternion and back would change relative errors in their seventh digit, and these figures are
// meant to equal those of other tools.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "geometry/se3.hpp"

namespace gastronaut {

struct Pose {
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  // metres

  Pose inverse() const { return {rotation.transpose(), -(rotation.transpose() * translation)}; }
  Pose operator*(const Pose& other) const {
    return {rotation * other.rotation, rotation * other.translation + translation};
  }
};

inline Pose to_pose(const SE3& transform) {
  return {transform.rotation.toRotationMatrix(), transform.translation};
}

inline bool is_finite(const SE3& pose) {
  return pose.translation.allFinite() && pose.rotation.coeffs().allFinite();
}

struct StampedPoses {
  std::vector<std::int64_t>
      utimes;  // microseconds, ascending; frame numbers where there is no time
  std::vector<Pose> poses;

  std::size_t size() const { return utimes.size(); }
};

}  // namespace gastronaut

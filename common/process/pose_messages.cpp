#include "process/pose_messages.hpp"

#include <cmath>
#include <limits>

namespace gastronaut {
namespace {

SE3 no_pose() {
  SE3 pose;
  pose.translation.setConstant(std::numeric_limits<double>::quiet_NaN());
  return pose;
}

Eigen::Vector3d vector3(const double (&v)[3]) { return {v[0], v[1], v[2]}; }

SE3 pose_from(const double (&position)[3], const double (&quaternion)[4]) {
  const Eigen::Quaterniond rotation(quaternion[0], quaternion[1], quaternion[2], quaternion[3]);
  const double norm = rotation.norm();
  if (!(norm > 0) || !std::isfinite(norm)) return no_pose();
  return {rotation.normalized(), vector3(position)};
}

}  // namespace

SE3 pose_of(const magnetic_pose_t& message) {
  const Eigen::Vector3d axis = vector3(message.axis);
  const double norm = axis.norm();
  if (!(norm > 0) || !std::isfinite(norm)) return no_pose();
  return {Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), axis),
          vector3(message.position)};
}

SE3 pose_of(const visual_pose_t& message) {
  return pose_from(message.position, message.orientation);
}

SE3 pose_of(const capsule_state_t& message) {
  return pose_from(message.position, message.orientation);
}

SE3 pose_of(const pose_t& message) { return pose_from(message.pos, message.orientation); }

SE3 pose_of(const rigid_transform_t& message) { return pose_from(message.trans, message.quat); }

}  // namespace gastronaut

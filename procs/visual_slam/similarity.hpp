// Rigid motion and scale: what takes a map to another frame and to other metres.
#pragma once

#include "geometry/se3.hpp"

namespace gastronaut::slam {

// x -> scale * rotation * x + translation. A pose goes along: its camera stays where it is in what
// it sees, and turns with it.
struct Similarity {
  double scale = 1;
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();  // unit
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();         // metres

  Eigen::Vector3d operator*(const Eigen::Vector3d& point) const {
    return scale * (rotation * point) + translation;
  }
  SE3 operator*(const SE3& pose) const {
    return {(rotation * pose.rotation).normalized(), *this * pose.translation};
  }
  // What it does to a twist in the camera's frame: lengths grow.
  Vector6d twist_factors() const {
    Vector6d factors;
    factors << scale, scale, scale, 1, 1, 1;
    return factors;
  }
};

}  // namespace gastronaut::slam

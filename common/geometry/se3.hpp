// Rigid transforms in three dimensions as one small value type.
// A variable `rig_T_camera` takes camera coordinates to rig coordinates.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gastronaut {

using Vector5d = Eigen::Matrix<double, 5, 1>;
using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix5d = Eigen::Matrix<double, 5, 5>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

// The matrix that makes skew(a) * b == a.cross(b).
Eigen::Matrix3d skew(const Eigen::Vector3d& v);

// Rotation by norm(rotation_vector) radians about rotation_vector.
Eigen::Quaterniond so3_exp(const Eigen::Vector3d& rotation_vector);
// Inverse of so3_exp, norm at most pi.
Eigen::Vector3d so3_log(const Eigen::Quaterniond& rotation);
// J with so3_exp(w + d) == so3_exp(J(w) d) so3_exp(w) to first order in d.
Eigen::Matrix3d so3_left_jacobian(const Eigen::Vector3d& rotation_vector);

struct SE3 {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();  // unit
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();         // metres

  // Twists are (translation, rotation), as the covariances on the wire are.
  static SE3 exp(const Vector6d& twist);
  Vector6d log() const;

  SE3 inverse() const;
  SE3 operator*(const SE3& other) const;
  Eigen::Vector3d operator*(const Eigen::Vector3d& point) const {
    return rotation * point + translation;
  }
  // exp(adjoint() * twist) * *this == *this * exp(twist).
  Matrix6d adjoint() const;
  Eigen::Matrix4d matrix() const;
};

// Constant-twist interpolation; fraction 0 gives a, 1 gives b.
SE3 interpolate(const SE3& a, const SE3& b, double fraction);

// Angle between two rotations in radians, 0..pi.
double angle_between(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b);

// Two unit vectors that complete `axis` (unit) to a right-handed frame (first, second, axis).
// Continuous in axis but for axis = -z. The tangent basis of every 5-DoF covariance.
Eigen::Matrix<double, 3, 2> perpendicular_basis(const Eigen::Vector3d& axis);

}  // namespace gastronaut

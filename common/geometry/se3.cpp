#include "geometry/se3.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

namespace gastronaut {
namespace {
// Below this angle the closed forms lose digits and their Taylor series are exact to rounding.
constexpr double kSmallAngle = 1e-5;
}  // namespace

Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d m;
  m << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return m;
}

Eigen::Quaterniond so3_exp(const Eigen::Vector3d& rotation_vector) {
  const double angle = rotation_vector.norm();
  const double sine_over_angle =
      angle < kSmallAngle ? 0.5 - angle * angle / 48 : std::sin(angle / 2) / angle;
  const Eigen::Vector3d vector = sine_over_angle * rotation_vector;
  return Eigen::Quaterniond(std::cos(angle / 2), vector.x(), vector.y(), vector.z()).normalized();
}

Eigen::Vector3d so3_log(const Eigen::Quaterniond& rotation) {
  const double sign = rotation.w() < 0 ? -1 : 1;
  const double sine = rotation.vec().norm();
  if (sine < kSmallAngle) return 2 * sign * rotation.vec();
  return sign * 2 * std::atan2(sine, sign * rotation.w()) / sine * rotation.vec();
}

Eigen::Matrix3d so3_left_jacobian(const Eigen::Vector3d& rotation_vector) {
  const double angle = rotation_vector.norm();
  const Eigen::Matrix3d w = skew(rotation_vector);
  if (angle < kSmallAngle) return Eigen::Matrix3d::Identity() + w / 2 + w * w / 6;
  const double squared = angle * angle;
  return Eigen::Matrix3d::Identity() + (1 - std::cos(angle)) / squared * w +
         (angle - std::sin(angle)) / (squared * angle) * w * w;
}

SE3 SE3::exp(const Vector6d& twist) {
  return {so3_exp(twist.tail<3>()), so3_left_jacobian(twist.tail<3>()) * twist.head<3>()};
}

Vector6d SE3::log() const {
  Vector6d twist;
  twist.tail<3>() = so3_log(rotation);
  twist.head<3>() = so3_left_jacobian(twist.tail<3>()).partialPivLu().solve(translation);
  return twist;
}

SE3 SE3::inverse() const {
  const Eigen::Quaterniond inverse_rotation = rotation.conjugate();
  return {inverse_rotation, -(inverse_rotation * translation)};
}

SE3 SE3::operator*(const SE3& other) const {
  return {(rotation * other.rotation).normalized(), rotation * other.translation + translation};
}

Matrix6d SE3::adjoint() const {
  const Eigen::Matrix3d r = rotation.toRotationMatrix();
  Matrix6d adjoint = Matrix6d::Zero();
  adjoint.topLeftCorner<3, 3>() = r;
  adjoint.topRightCorner<3, 3>() = skew(translation) * r;
  adjoint.bottomRightCorner<3, 3>() = r;
  return adjoint;
}

Eigen::Matrix4d SE3::matrix() const {
  Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
  m.topLeftCorner<3, 3>() = rotation.toRotationMatrix();
  m.topRightCorner<3, 1>() = translation;
  return m;
}

SE3 interpolate(const SE3& a, const SE3& b, double fraction) {
  return a * SE3::exp(fraction * (a.inverse() * b).log());
}

double angle_between(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b) {
  return so3_log(a.conjugate() * b).norm();
}

Eigen::Matrix<double, 3, 2> perpendicular_basis(const Eigen::Vector3d& axis) {
  // The shortest rotation that takes z to axis, applied to x and y.
  Eigen::Matrix<double, 3, 2> basis;
  const double denominator = 1 + axis.z();
  constexpr double kAntipodal = 1e-12;
  if (denominator < kAntipodal) {
    basis << 1, 0, 0, -1, 0, 0;
    return basis;
  }
  const double x = axis.x();
  const double y = axis.y();
  basis << 1 - x * x / denominator, -x * y / denominator,  //
      -x * y / denominator, 1 - y * y / denominator,       //
      -x, -y;
  return basis;
}

}  // namespace gastronaut

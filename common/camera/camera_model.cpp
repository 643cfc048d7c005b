#include "camera/camera_model.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>

namespace gastronaut {
namespace {

constexpr int kMaxIterations = 30;
constexpr double kConverged = 1e-14;  // normalised image units
// No lens of interest sees further from its axis; the search for the fold stops here.
constexpr double kWidestRadialTangential = 8.0;  // tangent of 83 degrees
constexpr int kFoldSearchSteps = 4000;

// Numerator and denominator of the radial factor and their derivatives by r^2.
struct Radial {
  double value;
  double derivative;
};

Radial radial_factor(const std::array<double, 8>& k, double r2) {
  // OpenCV's order: k1 k2 p1 p2 k3 k4 k5 k6.
  const double numerator = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  const double numerator_slope = k[0] + r2 * (2 * k[1] + 3 * r2 * k[4]);
  const double denominator = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]));
  const double denominator_slope = k[5] + r2 * (2 * k[6] + 3 * r2 * k[7]);
  return {numerator / denominator, (numerator_slope * denominator - numerator * denominator_slope) /
                                       (denominator * denominator)};
}

Radial fisheye_angle(const std::array<double, 8>& k, double angle) {
  const double a2 = angle * angle;
  return {angle * (1 + a2 * (k[0] + a2 * (k[1] + a2 * (k[2] + a2 * k[3])))),
          1 + a2 * (3 * k[0] + a2 * (5 * k[1] + a2 * (7 * k[2] + 9 * a2 * k[3])))};
}

}  // namespace

CameraModel::CameraModel(const CameraIntrinsics& intrinsics) : intrinsics_(intrinsics) {
  const auto& in = intrinsics_;
  if (in.width <= 0 || in.height <= 0) throw std::invalid_argument("camera: size must be positive");
  if (!(in.fx > 0) || !(in.fy > 0) || !std::isfinite(in.fx) || !std::isfinite(in.fy)) {
    throw std::invalid_argument("camera: focal lengths must be positive");
  }
  if (!(in.cx > -1) || !(in.cx < in.width) || !(in.cy > -1) || !(in.cy < in.height)) {
    throw std::invalid_argument("camera: the principal point must lie in the picture");
  }
  const std::size_t count = in.distortion.size();
  const std::size_t most = in.model == LensModel::kFisheye ? 4 : 8;
  if (count > most) {
    throw std::invalid_argument("camera: at most " + std::to_string(most) +
                                " distortion coefficients, not " + std::to_string(count));
  }
  for (std::size_t i = 0; i < count; ++i) {
    if (!std::isfinite(in.distortion[i])) {
      throw std::invalid_argument("camera: distortion coefficients must be finite");
    }
    k_[i] = in.distortion[i];
  }
  if (in.model == LensModel::kFisheye) {
    max_angle_ = std::numbers::pi;
    for (int i = 1; i <= kFoldSearchSteps; ++i) {
      const double angle = std::numbers::pi * i / kFoldSearchSteps;
      if (fisheye_angle(k_, angle).derivative <= 0) {
        max_angle_ = std::numbers::pi * (i - 1) / kFoldSearchSteps;
        break;
      }
    }
  } else {
    double radius = kWidestRadialTangential;
    for (int i = 1; i <= kFoldSearchSteps; ++i) {
      const double r = kWidestRadialTangential * i / kFoldSearchSteps;
      const Radial factor = radial_factor(k_, r * r);
      if (factor.value + 2 * r * r * factor.derivative <= 0) {
        radius = kWidestRadialTangential * (i - 1) / kFoldSearchSteps;
        break;
      }
    }
    max_radius_squared_ = radius * radius;
  }
}

Eigen::Vector2d CameraModel::distort(const Eigen::Vector2d& p, Eigen::Matrix2d& jacobian) const {
  const double x = p.x();
  const double y = p.y();
  const double r2 = p.squaredNorm();
  const Radial f = radial_factor(k_, r2);
  const double p1 = k_[2];
  const double p2 = k_[3];
  jacobian << f.value + 2 * x * x * f.derivative + 2 * p1 * y + 6 * p2 * x,
      2 * x * y * f.derivative + 2 * p1 * x + 2 * p2 * y,
      2 * x * y * f.derivative + 2 * p1 * x + 2 * p2 * y,
      f.value + 2 * y * y * f.derivative + 6 * p1 * y + 2 * p2 * x;
  return {x * f.value + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
          y * f.value + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y};
}

std::optional<Eigen::Vector2d> CameraModel::project_fisheye(
    const Eigen::Vector3d& point, Eigen::Matrix<double, 2, 3>& jacobian) const {
  const double radius = point.head<2>().norm();
  const double angle = std::atan2(radius, point.z());
  if (angle > max_angle_) return std::nullopt;
  const Eigen::Vector2d focal(intrinsics_.fx, intrinsics_.fy);
  const Eigen::Vector2d centre(intrinsics_.cx, intrinsics_.cy);
  constexpr double kOnAxis = 1e-9;  // radians: below it the projection is the plain pinhole's
  if (angle < kOnAxis) {
    jacobian << 1 / point.z(), 0, -point.x() / (point.z() * point.z()),  //
        0, 1 / point.z(), -point.y() / (point.z() * point.z());
    jacobian = focal.asDiagonal() * jacobian;
    return focal.cwiseProduct(point.head<2>() / point.z()) + centre;
  }
  const Radial distorted = fisheye_angle(k_, angle);
  const Eigen::Vector2d direction = point.head<2>() / radius;
  const double squared = point.squaredNorm();
  // d(angle)/d(point), then the turn of the direction within the picture.
  Eigen::RowVector3d angle_by_point;
  angle_by_point << direction.transpose() * point.z() / squared, -radius / squared;
  jacobian = direction * (distorted.derivative * angle_by_point);
  jacobian.leftCols<2>() +=
      distorted.value / radius * (Eigen::Matrix2d::Identity() - direction * direction.transpose());
  jacobian = focal.asDiagonal() * jacobian;
  return focal.cwiseProduct(distorted.value * direction) + centre;
}

std::optional<Eigen::Vector2d> CameraModel::project(const Eigen::Vector3d& point,
                                                    Eigen::Matrix<double, 2, 3>& jacobian) const {
  if (intrinsics_.model == LensModel::kFisheye) return project_fisheye(point, jacobian);
  if (!(point.z() > 0)) return std::nullopt;
  const Eigen::Vector2d normalised = point.head<2>() / point.z();
  if (normalised.squaredNorm() > max_radius_squared_) return std::nullopt;
  Eigen::Matrix2d by_normalised;
  const Eigen::Vector2d distorted = distort(normalised, by_normalised);
  Eigen::Matrix<double, 2, 3> normalised_by_point;
  normalised_by_point << 1 / point.z(), 0, -normalised.x() / point.z(),  //
      0, 1 / point.z(), -normalised.y() / point.z();
  const Eigen::Vector2d focal(intrinsics_.fx, intrinsics_.fy);
  jacobian = focal.asDiagonal() * by_normalised * normalised_by_point;
  return focal.cwiseProduct(distorted) + Eigen::Vector2d(intrinsics_.cx, intrinsics_.cy);
}

std::optional<Eigen::Vector2d> CameraModel::project(const Eigen::Vector3d& point) const {
  Eigen::Matrix<double, 2, 3> unused;
  return project(point, unused);
}

std::optional<Eigen::Vector3d> CameraModel::unproject(const Eigen::Vector2d& pixel) const {
  const Eigen::Vector2d target((pixel.x() - intrinsics_.cx) / intrinsics_.fx,
                               (pixel.y() - intrinsics_.cy) / intrinsics_.fy);
  if (!target.allFinite()) return std::nullopt;
  if (intrinsics_.model == LensModel::kFisheye) {
    const double distorted = std::hypot(target.x(), target.y());
    if (distorted == 0) return Eigen::Vector3d::UnitZ();
    if (distorted > fisheye_angle(k_, max_angle_).value) return std::nullopt;
    // Newton kept inside a bracket: the distorted angle grows all the way to max_angle_.
    double low = 0;
    double high = max_angle_;
    double angle = std::min(distorted, max_angle_);
    for (int i = 0; i < kMaxIterations * 2; ++i) {
      const Radial f = fisheye_angle(k_, angle);
      const double error = f.value - distorted;
      (error > 0 ? high : low) = angle;
      double next = f.derivative > 0 ? angle - error / f.derivative : -1;
      if (!(next > low && next < high)) next = (low + high) / 2;
      const double step = std::abs(next - angle);
      angle = next;
      if (step < kConverged) break;
    }
    const Eigen::Vector2d direction = target / distorted;
    return Eigen::Vector3d(std::sin(angle) * direction.x(), std::sin(angle) * direction.y(),
                           std::cos(angle));
  }
  Eigen::Vector2d p = target;
  if (p.squaredNorm() > max_radius_squared_) p *= std::sqrt(max_radius_squared_ / p.squaredNorm());
  for (int i = 0; i < kMaxIterations; ++i) {
    Eigen::Matrix2d jacobian;
    const Eigen::Vector2d error = distort(p, jacobian) - target;
    Eigen::Vector2d step = jacobian.partialPivLu().solve(error);
    // Newton may overshoot the fold; halve until the residual falls.
    for (int halvings = 0; halvings < 8; ++halvings) {
      Eigen::Matrix2d unused;
      if ((distort(p - step, unused) - target).norm() <= error.norm()) break;
      step /= 2;
    }
    p -= step;
    if (step.norm() < kConverged) break;
  }
  Eigen::Matrix2d unused;
  constexpr double kInverted = 1e-9;
  if (!p.allFinite() || p.squaredNorm() > max_radius_squared_ ||
      (distort(p, unused) - target).norm() > kInverted) {
    return std::nullopt;
  }
  return Eigen::Vector3d(p.x(), p.y(), 1).normalized();
}

}  // namespace gastronaut

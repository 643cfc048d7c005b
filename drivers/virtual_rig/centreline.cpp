#include "virtual_rig/centreline.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>

namespace gastronaut {
namespace {

constexpr Eigen::Index kAngles = 48;

// Weights of the uniform cubic B-spline: twice continuously differentiable, so that a camera that
// follows the axis has a continuous acceleration.
std::array<double, 4> spline(double t) {
  const double u = 1 - t;
  return {u * u * u / 6, (3 * t * t * t - 6 * t * t + 4) / 6,
          (-3 * t * t * t + 3 * t * t + 3 * t + 1) / 6, t * t * t / 6};
}
std::array<double, 4> spline_slope(double t) {
  const double u = 1 - t;
  return {-u * u / 2, (3 * t * t - 4 * t) / 2, (-3 * t * t + 2 * t + 1) / 2, t * t / 2};
}

struct Place {
  std::ptrdiff_t first;  // the spline reaches from first - 1 to first + 2
  double t;
};
Place locate(double position, std::ptrdiff_t last) {
  const double clamped = std::clamp(position, 0.0, static_cast<double>(last));
  const auto first = std::min(static_cast<std::ptrdiff_t>(clamped), last - 1);
  return {first, clamped - static_cast<double>(first)};
}

}  // namespace

Centreline::Centreline(std::vector<Eigen::Vector3d> points,
                       const std::function<double(std::size_t, double)>& radius)
    : points_(std::move(points)) {
  if (points_.size() < 4) throw std::invalid_argument("a centreline needs at least four points");
  radius_.resize(static_cast<Eigen::Index>(points_.size()), kAngles);
  for (std::size_t i = 0; i < points_.size(); ++i) {
    if (i > 0) length_ += (points_[i] - points_[i - 1]).norm();
    for (Eigen::Index k = 0; k < kAngles; ++k) {
      radius_(static_cast<Eigen::Index>(i), k) =
          radius(i, 2 * std::numbers::pi * static_cast<double>(k) / kAngles);
    }
  }
}

Centreline::Frame Centreline::frame(double fraction) const {
  const auto last = static_cast<std::ptrdiff_t>(points_.size()) - 1;
  const Place place = locate(fraction * static_cast<double>(last), last);
  const auto weights = spline(place.t);
  const auto slopes = spline_slope(place.t);
  Frame frame;
  frame.centre.setZero();
  frame.tangent.setZero();
  for (std::ptrdiff_t k = 0; k < 4; ++k) {
    const std::ptrdiff_t wanted = place.first + k - 1;
    const auto n = static_cast<std::size_t>(std::clamp<std::ptrdiff_t>(wanted, 0, last));
    // Beyond the ends the axis goes straight on.
    Eigen::Vector3d point = points_[n];
    if (wanted < 0) point += points_[0] - points_[1];
    if (wanted > last) point += points_[n] - points_[n - 1];
    frame.centre += weights[static_cast<std::size_t>(k)] * point;
    frame.tangent += slopes[static_cast<std::size_t>(k)] * point;
  }
  frame.tangent.normalize();
  frame.side = Eigen::Vector3d::UnitZ().cross(frame.tangent).normalized();
  frame.up = frame.tangent.cross(frame.side);
  return frame;
}

double Centreline::radius(double fraction, double angle) const {
  const auto last = static_cast<std::ptrdiff_t>(points_.size()) - 1;
  const Place along = locate(fraction * static_cast<double>(last), last);
  const double turns = angle / (2 * std::numbers::pi);
  const double step = (turns - std::floor(turns)) * static_cast<double>(kAngles);
  const auto first_angle = static_cast<std::ptrdiff_t>(step);
  const auto along_weights = spline(along.t);
  const auto angle_weights = spline(step - static_cast<double>(first_angle));
  double radius = 0;
  for (std::ptrdiff_t i = 0; i < 4; ++i) {
    for (std::ptrdiff_t k = 0; k < 4; ++k) {
      radius += along_weights[static_cast<std::size_t>(i)] *
                angle_weights[static_cast<std::size_t>(k)] *
                radius_(std::clamp<std::ptrdiff_t>(along.first + i - 1, 0, last),
                        (first_angle + k - 1 + kAngles) % kAngles);
    }
  }
  return radius;
}

double Centreline::nearest(const Eigen::Vector3d& point) const {
  double best = std::numeric_limits<double>::infinity();
  double fraction = 0;
  for (std::size_t i = 0; i + 1 < points_.size(); ++i) {
    const Eigen::Vector3d along = points_[i + 1] - points_[i];
    const double t = std::clamp((point - points_[i]).dot(along) / along.squaredNorm(), 0.0, 1.0);
    const double distance = (point - points_[i] - t * along).squaredNorm();
    if (distance >= best) continue;
    best = distance;
    fraction = (static_cast<double>(i) + t) / static_cast<double>(points_.size() - 1);
  }
  return fraction;
}

}  // namespace gastronaut

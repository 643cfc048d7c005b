#include "virtual_rig/ring_magnet.hpp"

#include <array>
#include <cmath>
#include <numbers>

#include "geometry/se3.hpp"
#include "magnetics/dipole.hpp"

namespace gastronaut {
namespace {

// Four-point Gauss-Legendre rule on [-1, 1].
constexpr std::array<double, 4> kNodes = {-0.8611363115940526, -0.3399810435848563,
                                          0.3399810435848563, 0.8611363115940526};
constexpr std::array<double, 4> kWeights = {0.3478548451374538, 0.6521451548625461,
                                            0.6521451548625461, 0.3478548451374538};
constexpr int kAzimuths = 16;

}  // namespace

RingMagnet::RingMagnet(const AxialMagnetShape& shape, double moment) : moment_(moment) {
  const double a = shape.outer_radius;
  const double c = shape.inner_radius;
  if (a == 0 || shape.length == 0) return;
  // Charge per area is the magnetisation: moment over volume.
  const double magnetisation = moment / (std::numbers::pi * (a * a - c * c) * shape.length);
  points_.resize(3, 2 * static_cast<Eigen::Index>(kNodes.size()) * kAzimuths);
  charges_.resize(points_.cols());
  Eigen::Index n = 0;
  for (const double sign : {1.0, -1.0}) {
    for (std::size_t i = 0; i < kNodes.size(); ++i) {
      const double radius = (a + c) / 2 + (a - c) / 2 * kNodes[i];
      const double ring_area = kWeights[i] * (a - c) / 2 * radius * 2 * std::numbers::pi;
      for (int k = 0; k < kAzimuths; ++k, ++n) {
        const double azimuth = 2 * std::numbers::pi * k / kAzimuths;
        points_.col(n) << radius * std::cos(azimuth), radius * std::sin(azimuth),
            sign * shape.length / 2;
        charges_[n] = sign * kMagneticConstantOver4Pi * magnetisation * ring_area / kAzimuths;
      }
    }
  }
}

Eigen::Vector3d RingMagnet::field(const Eigen::Vector3d& offset,
                                  const Eigen::Vector3d& axis) const {
  if (charges_.size() == 0) return dipole_field(offset, moment_ * axis);
  Eigen::Matrix3d frame;
  frame << perpendicular_basis(axis), axis;
  const Eigen::Vector3d local = frame.transpose() * offset;
  Eigen::Vector3d field = Eigen::Vector3d::Zero();
  for (Eigen::Index n = 0; n < charges_.size(); ++n) {
    const Eigen::Vector3d from = local - points_.col(n);
    const double r2 = from.squaredNorm();
    field += charges_[n] / (r2 * std::sqrt(r2)) * from;
  }
  return frame * field;
}

}  // namespace gastronaut

#include "magnetics/axial_magnet.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "magnetics/dipole.hpp"

namespace gastronaut {
namespace {

const AxialMagnetShape kRing{0.0055, 0.003, 0.006};  // the capsule's, metres
const Eigen::Vector3d kMoment(0.25, -0.2, 0.25);     // A m^2

// A uniformly magnetised ring as many dipoles spread over its volume.
Eigen::Vector3d ring_of_dipoles(const AxialMagnetShape& shape, const Eigen::Vector3d& offset,
                                const Eigen::Vector3d& moment) {
  constexpr int kRadial = 24;
  constexpr int kAround = 48;
  constexpr int kAlong = 24;
  const Eigen::Quaterniond turn =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), moment.normalized());
  Eigen::Vector3d field = Eigen::Vector3d::Zero();
  double weight = 0;
  for (int i = 0; i < kRadial; ++i) {
    const double radius =
        shape.inner_radius + (shape.outer_radius - shape.inner_radius) * (i + 0.5) / kRadial;
    for (int j = 0; j < kAround; ++j) {
      const double angle = 2 * std::numbers::pi * j / kAround;
      for (int k = 0; k < kAlong; ++k) {
        const double along = shape.length * ((k + 0.5) / kAlong - 0.5);
        const Eigen::Vector3d part =
            turn * Eigen::Vector3d(radius * std::cos(angle), radius * std::sin(angle), along);
        field += radius * dipole_field(offset - part, moment);
        weight += radius;
      }
    }
  }
  return field / weight;
}

TEST(AxialMagnet, OctupoleLeavesTheFourthPowerOfSizeOverDistance) {
  const double size = std::hypot(kRing.outer_radius, kRing.length / 2);
  constexpr double kNextMultipole = 5;  // its coefficient is of that order
  constexpr double kQuadrature = 3e-5;  // of the sum over dipoles
  for (const double distance : {0.02, 0.03, 0.05, 0.08}) {
    for (const Eigen::Vector3d& direction :
         {Eigen::Vector3d(1, 0, 0), Eigen::Vector3d(0.3, -0.5, 0.8), Eigen::Vector3d(0, 1, 0.2)}) {
      const Eigen::Vector3d offset = distance * direction.normalized();
      const Eigen::Vector3d expected = ring_of_dipoles(kRing, offset, kMoment);
      const double ratio = octupole_ratio(kRing);
      const double error =
          (axial_magnet_field(offset, kMoment, ratio) - expected).norm() / expected.norm();
      EXPECT_LT(error, kNextMultipole * std::pow(size / distance, 4) + kQuadrature);
      const double dipole_error = (dipole_field(offset, kMoment) - expected).norm();
      EXPECT_GT(dipole_error, error * expected.norm());
    }
  }
}

TEST(AxialMagnet, APointDipoleHasNoOctupole) {
  EXPECT_EQ(octupole_ratio(AxialMagnetShape()), 0);
  const Eigen::Vector3d offset(0.02, 0.01, -0.03);
  EXPECT_EQ(axial_magnet_field(offset, kMoment, 0), dipole_field(offset, kMoment));
  EXPECT_EQ(axial_magnet_field(offset, Eigen::Vector3d::Zero(), 1e-5), Eigen::Vector3d::Zero());
}

TEST(AxialMagnet, DerivativesAreThoseOfTheField) {
  constexpr double kStep = 1e-6;
  constexpr double kDifferenceError = 1e-6;
  constexpr double kRounding = 1e-12;
  const double ratio = octupole_ratio(kRing);
  const Eigen::Vector3d offset(0.015, -0.02, 0.018);
  const AxialMagnetDerivatives analytic = axial_magnet_derivatives(offset, kMoment, ratio);
  Eigen::Matrix3d by_offset;
  Eigen::Matrix3d by_moment;
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(k);
    by_offset.col(k) = (axial_magnet_field(offset + step, kMoment, ratio) -
                        axial_magnet_field(offset - step, kMoment, ratio)) /
                       (2 * kStep);
    by_moment.col(k) = (axial_magnet_field(offset, kMoment + step, ratio) -
                        axial_magnet_field(offset, kMoment - step, ratio)) /
                       (2 * kStep);
  }
  EXPECT_EQ(analytic.field, axial_magnet_field(offset, kMoment, ratio));
  EXPECT_LT((analytic.by_offset - by_offset).norm(), kDifferenceError * by_offset.norm());
  EXPECT_LT((analytic.by_moment - by_moment).norm(), kDifferenceError * by_moment.norm());
  // Outside the magnet the field has neither curl nor divergence.
  EXPECT_LT((analytic.by_offset - analytic.by_offset.transpose()).norm(),
            kRounding * by_offset.norm());
  EXPECT_LT(std::abs(analytic.by_offset.trace()), kRounding * by_offset.norm());
}

}  // namespace
}  // namespace gastronaut

#include "virtual_rig/ring_magnet.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>
#include <vector>

#include "magnetics/dipole.hpp"

namespace gastronaut {
namespace {

const AxialMagnetShape kRing = {0.0055, 0.003, 0.006};
constexpr double kMoment = 0.408;
const Eigen::Vector3d kAxis = Eigen::Vector3d(0.3, -0.5, 0.8).normalized();

std::vector<Eigen::Vector3d> directions() {
  return {kAxis, kAxis.unitOrthogonal(), Eigen::Vector3d(0.9, 0.1, 0.4).normalized()};
}

// The same ring filled with small dipoles at the middles of cells.
Eigen::Vector3d field_of_many_dipoles(const Eigen::Vector3d& offset) {
  constexpr int kRadii = 120;
  constexpr int kAzimuths = 32;
  constexpr int kHeights = 300;
  const Eigen::Vector3d x = kAxis.unitOrthogonal();
  const Eigen::Vector3d y = kAxis.cross(x);
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double weights = 0;
  for (int i = 0; i < kRadii; ++i) {
    const double radius =
        kRing.inner_radius + (kRing.outer_radius - kRing.inner_radius) * (i + 0.5) / kRadii;
    for (int j = 0; j < kAzimuths; ++j) {
      const double azimuth = 2 * std::numbers::pi * j / kAzimuths;
      for (int k = 0; k < kHeights; ++k) {
        const double height = kRing.length * ((k + 0.5) / kHeights - 0.5);
        const Eigen::Vector3d at =
            radius * (std::cos(azimuth) * x + std::sin(azimuth) * y) + height * kAxis;
        sum += radius * dipole_field(offset - at, kMoment * kAxis);
        weights += radius;
      }
    }
  }
  return sum / weights;
}

TEST(RingMagnet, EqualsTheSumOfItsDipolesAtThirtyMillimetres) {
  // What the sum of midpoints leaves: cells of 0.02 mm, second order, at 30 mm.
  constexpr double kCells = 1e-6;
  const RingMagnet ring(kRing, kMoment);
  for (const Eigen::Vector3d& direction : directions()) {
    const Eigen::Vector3d offset = 0.03 * direction;
    const Eigen::Vector3d expected = field_of_many_dipoles(offset);
    EXPECT_LT((ring.field(offset, kAxis) - expected).norm(), kCells * expected.norm());
  }
}

TEST(RingMagnet, FarAwayIsAPointDipole) {
  // The octupole falls as (size / distance)^2: 2e-5 m^2 of it at one metre, times at most four.
  constexpr double kOctupole = 1e-4;
  const RingMagnet ring(kRing, kMoment);
  for (const Eigen::Vector3d& direction : directions()) {
    const Eigen::Vector3d expected = dipole_field(direction, kMoment * kAxis);
    EXPECT_LT((ring.field(direction, kAxis) - expected).norm(), kOctupole * expected.norm());
  }
}

TEST(RingMagnet, AgreesWithTheLocalisersSeriesWhereThatHolds) {
  // The series ends before (size / distance)^4 = 2e-5 at 80 mm, times the terms' numbers.
  constexpr double kNextTerm = 1e-4;
  const RingMagnet ring(kRing, kMoment);
  for (const Eigen::Vector3d& direction : directions()) {
    const Eigen::Vector3d offset = 0.08 * direction;
    const Eigen::Vector3d exact = ring.field(offset, kAxis);
    const Eigen::Vector3d series =
        axial_magnet_field(offset, kMoment * kAxis, octupole_ratio(kRing));
    const Eigen::Vector3d dipole = dipole_field(offset, kMoment * kAxis);
    EXPECT_LT((series - exact).norm(), kNextTerm * exact.norm());
    EXPECT_LT((series - exact).norm(), (dipole - exact).norm());
  }
}

TEST(RingMagnet, WithoutSizeIsExactlyADipole) {
  const RingMagnet point({}, kMoment);
  const Eigen::Vector3d offset(0.02, 0.03, -0.05);
  EXPECT_EQ(point.field(offset, kAxis), dipole_field(offset, kMoment * kAxis));
}

}  // namespace
}  // namespace gastronaut

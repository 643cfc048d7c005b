#include "virtual_rig/finite_coil.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <numbers>

#include "magnetics/dipole.hpp"

namespace gastronaut {
namespace {

constexpr double kRadius = 0.025;
constexpr double kRounding = 1e-12;

TEST(CurrentLoop, OnItsAxisFollowsTheClosedForm) {
  for (const double z : {-0.1, 0.0, 0.03, 0.2}) {
    const double squared = kRadius * kRadius + z * z;
    const double expected = 2 * std::numbers::pi * kMagneticConstantOver4Pi * kRadius * kRadius /
                            (squared * std::sqrt(squared));
    const Eigen::Vector3d field = current_loop_field({0, 0, z}, kRadius);
    EXPECT_NEAR(field.z(), expected, kRounding * expected);
    EXPECT_EQ(field.head<2>().norm(), 0);
  }
}

TEST(CurrentLoop, OffItsAxisEqualsBiotSavart) {
  constexpr int kSegments = 20000;
  constexpr double kPolygon = 1e-7;  // relative, (2 pi / kSegments)^2 and rounding
  for (const Eigen::Vector3d& point :
       {Eigen::Vector3d(0.01, -0.02, 0.03), Eigen::Vector3d(0.07, 0.05, 0.21),
        Eigen::Vector3d(0.04, 0, 0)}) {
    Eigen::Vector3d expected = Eigen::Vector3d::Zero();
    for (int i = 0; i < kSegments; ++i) {
      const auto on_wire = [](double n) {
        const double angle = 2 * std::numbers::pi * n / kSegments;
        return Eigen::Vector3d(kRadius * std::cos(angle), kRadius * std::sin(angle), 0);
      };
      const Eigen::Vector3d from = point - on_wire(i + 0.5);
      const double distance = from.norm();
      expected += kMagneticConstantOver4Pi * (on_wire(i + 1) - on_wire(i)).cross(from) /
                  (distance * distance * distance);
    }
    EXPECT_LT((current_loop_field(point, kRadius) - expected).norm(), kPolygon * expected.norm());
  }
}

TEST(CurrentLoop, FarAwayIsADipole) {
  constexpr double kLeftOver = 1e-3;  // (radius / distance)^2 and its factor
  const Eigen::Vector3d offset(0.9, -0.4, 0.7);
  const Eigen::Vector3d moment(0, 0, std::numbers::pi * kRadius * kRadius);
  const Eigen::Vector3d expected = dipole_field(offset, moment);
  EXPECT_LT((current_loop_field(offset, kRadius) - expected).norm(), kLeftOver * expected.norm());
}

TEST(Coil, OnItsAxisFollowsTheThickSolenoid) {
  CoilGeometryConfiguration coil;
  coil.rows = coil.cols = 1;
  // Layers of 2 mm: the mean of r^2 over a layer is off by 2^2 / 12 mm^2 of 496 mm^2.
  constexpr double kLayers = 1e-3;
  const double z = 0.085;
  const double density = coil.turns / (coil.length * (coil.outer_radius - coil.inner_radius));
  const auto edge = [&](double x) {
    return x * std::log((coil.outer_radius + std::hypot(coil.outer_radius, x)) /
                        (coil.inner_radius + std::hypot(coil.inner_radius, x)));
  };
  const double height = z - coil.z;
  const double expected = 2 * std::numbers::pi * kMagneticConstantOver4Pi * density *
                          (edge(height + coil.length / 2) - edge(height - coil.length / 2));
  const Eigen::Matrix3Xd fields = coil_fields(coil, {0, 0, z});
  ASSERT_EQ(fields.cols(), 1);
  EXPECT_NEAR(fields(2, 0), expected, kLayers * expected);
}

TEST(Coil, NumbersFollowTheGrid) {
  const CoilGeometryConfiguration coils;
  // Above coil row 0, col 2 its own field is the largest.
  const Eigen::Matrix3Xd fields = coil_fields(coils, {-coils.pitch, coils.pitch, 0});
  Eigen::Index strongest = 0;
  fields.row(2).maxCoeff(&strongest);
  EXPECT_EQ(strongest, 2);
}

}  // namespace
}  // namespace gastronaut

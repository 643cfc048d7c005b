#include "virtual_rig/finite_coil.hpp"

#include <cmath>

#include "magnetics/dipole.hpp"

namespace gastronaut {
namespace {

// Loops that a winding is cut into, across and along.
constexpr int kLayers = 6;
constexpr int kRings = 16;

}  // namespace

Eigen::Vector3d current_loop_field(const Eigen::Vector3d& offset, double a) {
  const double rho = offset.head<2>().norm();
  const double z = offset.z();
  const double outer2 = (a + rho) * (a + rho) + z * z;
  const double inner2 = (a - rho) * (a - rho) + z * z;
  const double k = std::sqrt(4 * a * rho / outer2);
  const double first = std::comp_ellint_1(k);
  const double second = std::comp_ellint_2(k);
  const double scale = 2 * kMagneticConstantOver4Pi / std::sqrt(outer2);
  Eigen::Vector3d field(0, 0, scale * (first + (a * a - rho * rho - z * z) / inner2 * second));
  constexpr double kOnAxis = 1e-9;  // of the radius: there the radial field vanishes
  if (rho > kOnAxis * a) {
    const double radial =
        scale * z / rho * (-first + (a * a + rho * rho + z * z) / inner2 * second);
    field.head<2>() = radial / rho * offset.head<2>();
  }
  return field;
}

Eigen::Matrix3Xd coil_fields(const CoilGeometryConfiguration& coils, const Eigen::Vector3d& point) {
  Eigen::Matrix3Xd fields = Eigen::Matrix3Xd::Zero(3, coils.rows * coils.cols);
  const double turns_per_loop = static_cast<double>(coils.turns) / (kLayers * kRings);
  for (int row = 0; row < coils.rows; ++row) {
    for (int col = 0; col < coils.cols; ++col) {
      const Eigen::Vector3d centre((row - (coils.rows - 1) / 2.0) * coils.pitch,
                                   (col - (coils.cols - 1) / 2.0) * coils.pitch, coils.z);
      for (int layer = 0; layer < kLayers; ++layer) {
        const double radius = coils.inner_radius +
                              (coils.outer_radius - coils.inner_radius) * (layer + 0.5) / kLayers;
        for (int ring = 0; ring < kRings; ++ring) {
          const Eigen::Vector3d height(0, 0, coils.length * ((ring + 0.5) / kRings - 0.5));
          fields.col(row * coils.cols + col) +=
              turns_per_loop * current_loop_field(point - centre - height, radius);
        }
      }
    }
  }
  return fields;
}

}  // namespace gastronaut

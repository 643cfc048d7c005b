// Field of a magnet that is symmetric about its axis (disc, cylinder, ring), as the first two terms
// of its multipole series: the point dipole and the octupole. The quadrupole vanishes by symmetry;
// what is left out falls as (size / distance)^4. For a ring of outer radius a, inner radius c and
// half length b the octupole belongs to the dipole as b^2 - 3/4 (a^2 + c^2) to one.
#pragma once

#include <Eigen/Core>

namespace gastronaut {

struct AxialMagnetShape {
  double outer_radius = 0;  // metres
  double inner_radius = 0;
  double length = 0;
};

// Ratio of the octupole to the dipole moment in square metres; zero for a point dipole.
double octupole_ratio(const AxialMagnetShape& shape);

// Field in tesla at `offset` (field point minus magnet centre, metres) of a magnet with the given
// moment vector (A m^2) and octupole ratio (m^2).
Eigen::Vector3d axial_magnet_field(const Eigen::Vector3d& offset, const Eigen::Vector3d& moment,
                                   double octupole_ratio);

struct AxialMagnetDerivatives {
  Eigen::Vector3d field;      // tesla
  Eigen::Matrix3d by_offset;  // tesla per metre; by the magnet's position: its negative
  Eigen::Matrix3d by_moment;  // tesla per A m^2
};
AxialMagnetDerivatives axial_magnet_derivatives(const Eigen::Vector3d& offset,
                                                const Eigen::Vector3d& moment,
                                                double octupole_ratio);

}  // namespace gastronaut

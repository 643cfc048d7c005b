// Field of a point dipole with its analytic derivatives (Jackson, Classical Electrodynamics, 5.56).
#pragma once

#include <Eigen/Core>

namespace gastronaut {

constexpr double kMagneticConstantOver4Pi = 1e-7;  // tesla metre per ampere

// Field in tesla at `offset` = field point minus dipole, metres; moment in A m^2.
// B = 1e-7 (3 (m.u) u - m) / r^3. The offset must not be zero.
Eigen::Vector3d dipole_field(const Eigen::Vector3d& offset, const Eigen::Vector3d& moment);

// dB/d(moment), tesla per A m^2: the field is linear in the moment.
Eigen::Matrix3d dipole_field_by_moment(const Eigen::Vector3d& offset);

// dB/d(offset), tesla per metre. Symmetric and free of trace (curl and divergence vanish);
// the derivative by the dipole's own position is its negative.
Eigen::Matrix3d dipole_field_by_offset(const Eigen::Vector3d& offset,
                                       const Eigen::Vector3d& moment);

}  // namespace gastronaut

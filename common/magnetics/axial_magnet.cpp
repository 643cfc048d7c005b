#include "magnetics/axial_magnet.hpp"

#include <cmath>

#include "magnetics/dipole.hpp"

namespace gastronaut {

double octupole_ratio(const AxialMagnetShape& shape) {
  const double half_length = shape.length / 2;
  return half_length * half_length -
         0.75 * (shape.outer_radius * shape.outer_radius + shape.inner_radius * shape.inner_radius);
}

// With m the moment vector, M its norm, d the offset, r its norm and s = m.d / M, the octupole's
// potential is 1e-7 M q (5 s^3 - 3 s r^2) / (2 r^7), the field its negative gradient.
Eigen::Vector3d axial_magnet_field(const Eigen::Vector3d& d, const Eigen::Vector3d& moment,
                                   double q) {
  const double magnitude = moment.norm();
  if (magnitude == 0) return Eigen::Vector3d::Zero();
  const double r2 = d.squaredNorm();
  const double s = moment.dot(d) / magnitude;
  const double r5 = r2 * r2 * std::sqrt(r2);
  const double r7 = r5 * r2;
  const double along_axis = 1.5 / r5 - 7.5 * s * s / r7;
  const double along_offset = (17.5 * s * s * s / r2 - 7.5 * s) / r7;
  return dipole_field(d, moment) +
         kMagneticConstantOver4Pi * q * (along_axis * moment + magnitude * along_offset * d);
}

AxialMagnetDerivatives axial_magnet_derivatives(const Eigen::Vector3d& d,
                                                const Eigen::Vector3d& moment, double q) {
  AxialMagnetDerivatives result;
  result.field = axial_magnet_field(d, moment, q);
  result.by_offset = dipole_field_by_offset(d, moment);
  result.by_moment = dipole_field_by_moment(d);
  const double magnitude = moment.norm();
  if (magnitude == 0 || q == 0) return result;
  const Eigen::Vector3d axis = moment / magnitude;
  const double r2 = d.squaredNorm();
  const double s = axis.dot(d);
  const double s2 = s * s;
  const double r5 = r2 * r2 * std::sqrt(r2);
  const double r7 = r5 * r2;
  const double r9 = r7 * r2;
  const double r11 = r9 * r2;
  const Eigen::Matrix3d identity = Eigen::Matrix3d::Identity();
  const double along_axis = 1.5 / r5 - 7.5 * s2 / r7;
  const double along_offset = 17.5 * s2 * s / r9 - 7.5 * s / r7;
  const Eigen::RowVector3d along_axis_by_offset =
      (-15 * s / r7) * axis.transpose() + (-7.5 / r7 + 52.5 * s2 / r9) * d.transpose();
  const Eigen::RowVector3d along_offset_by_offset =
      (52.5 * s2 / r9 - 7.5 / r7) * axis.transpose() +
      (-157.5 * s2 * s / r11 + 52.5 * s / r9) * d.transpose();
  const double scale = kMagneticConstantOver4Pi * q;
  result.by_offset +=
      scale * magnitude *
      (axis * along_axis_by_offset + d * along_offset_by_offset + along_offset * identity);
  // The moment acts through its magnitude (linear) and through the axis (s = axis . d).
  const Eigen::Vector3d shape = along_axis * axis + along_offset * d;
  const Eigen::Matrix3d axis_by_moment = (identity - axis * axis.transpose()) / magnitude;
  Eigen::Matrix3d shape_by_axis = along_axis * identity;
  shape_by_axis += axis * ((-15 * s / r7) * d.transpose());
  shape_by_axis += d * ((52.5 * s2 / r9 - 7.5 / r7) * d.transpose());
  result.by_moment +=
      scale * (shape * axis.transpose() + magnitude * shape_by_axis * axis_by_moment);
  return result;
}

}  // namespace gastronaut

#include "magnetics/dipole.hpp"

#include <cmath>

namespace gastronaut {

Eigen::Vector3d dipole_field(const Eigen::Vector3d& offset, const Eigen::Vector3d& moment) {
  const double r2 = offset.squaredNorm();
  const double r3 = r2 * std::sqrt(r2);
  return kMagneticConstantOver4Pi / r3 * (3 * offset.dot(moment) / r2 * offset - moment);
}

Eigen::Matrix3d dipole_field_by_moment(const Eigen::Vector3d& offset) {
  const double r2 = offset.squaredNorm();
  const double r3 = r2 * std::sqrt(r2);
  return kMagneticConstantOver4Pi / r3 *
         (3 / r2 * offset * offset.transpose() - Eigen::Matrix3d::Identity());
}

Eigen::Matrix3d dipole_field_by_offset(const Eigen::Vector3d& offset,
                                       const Eigen::Vector3d& moment) {
  const double r2 = offset.squaredNorm();
  const double r5 = r2 * r2 * std::sqrt(r2);
  const double along = offset.dot(moment);
  const Eigen::Matrix3d outer = offset * moment.transpose();
  return 3 * kMagneticConstantOver4Pi / r5 *
         (outer + outer.transpose() + along * Eigen::Matrix3d::Identity() -
          5 * along / r2 * offset * offset.transpose());
}

}  // namespace gastronaut

// Field of an axially magnetised ring of finite size: its two end faces carry opposite magnetic
// charge, B = mu0/(4 pi) M integral of +-(r - r') / |r - r'|^3 over the faces. Integrated by
// Gauss-Legendre points along the radius and equal steps in azimuth, which converge exponentially
// outside the magnet: better than 1e-6 from 30 mm on for a capsule's ring.
#pragma once

#include <Eigen/Core>

#include "magnetics/axial_magnet.hpp"

namespace gastronaut {

class RingMagnet {
 public:
  // Moment in A m^2. A shape of size zero is a point dipole.
  RingMagnet(const AxialMagnetShape& shape, double moment);

  // Field in tesla at `offset` = field point minus magnet centre (metres); `axis` is the unit
  // vector of the moment.
  Eigen::Vector3d field(const Eigen::Vector3d& offset, const Eigen::Vector3d& axis) const;

 private:
  double moment_;
  // Charged points in the magnet's own frame (metres) and mu0/(4 pi) times their charge (T m^2).
  Eigen::Matrix3Xd points_;
  Eigen::VectorXd charges_;
};

}  // namespace gastronaut

// Field of the magnet and the uniform background at every sensor, with derivatives: the same
// mathematics as common/magnetics/axial_magnet.hpp, for all sensors at once, over contiguous
// arrays that the compiler vectorises.
//
// With d from the magnet to the sensor, r its norm, a the axis, s = a.d and q the octupole ratio:
//   B = 1e-7 moment (alpha a + beta d) + background
//   alpha = -1/r^3 + q (1.5/r^5 - 7.5 s^2/r^7),  beta = 3 s/r^5 + q (17.5 s^3/r^9 - 7.5 s/r^7).
#pragma once

#include <Eigen/Core>

#include "magnetic_localizer/magnet_state.hpp"
#include "magnetic_localizer/sensor_array.hpp"

namespace gastronaut::magnetics {

// Vectors over sensors of field components: all sensors' x, then y, then z.
struct ArrayField {
  explicit ArrayField(Eigen::Index num_sensors)
      : field(3 * num_sensors), by_unknown(3 * num_sensors, kNumMagnetUnknowns) {}

  Eigen::VectorXd field;  // tesla, background included
  Eigen::Matrix<double, Eigen::Dynamic, kNumMagnetUnknowns> by_unknown;
};

class MagnetModel {
 public:
  MagnetModel(const SensorArray& array, double octupole_ratio)
      : array_(array), octupole_ratio_(octupole_ratio) {}

  void field(const MagnetState& state, Eigen::VectorXd& field) const;
  void field_and_derivatives(const MagnetState& state, ArrayField& result) const;

 private:
  const SensorArray& array_;
  double octupole_ratio_;
};

}  // namespace gastronaut::magnetics

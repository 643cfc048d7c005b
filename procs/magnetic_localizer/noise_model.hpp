// How far each sensor's reading can be trusted, and what it therefore says about the field.
#pragma once

#include <Eigen/Core>
#include <array>

#include "magnetic_localizer/sensor_array.hpp"

namespace gastronaut::magnetics {

// Symmetric 3x3 matrices of all sensors; the six entries in the order xx, xy, xz, yy, yz, zz.
using SensorMatrices = std::array<Eigen::VectorXd, 6>;

// Covariance of each sensor's three readings. In a field B a sensor with the response rows r_i and
// with independent errors of gain (per axis), alignment (one small rotation) and offset has
//   V_ij = (noise^2 + offset^2 + removal_i + gain^2 (r_i.B)^2) delta_ij
//          + alignment^2 (B x r_i).(B x r_j).
// The gain does not act on the coil field: that was measured with the same sensors.
class NoiseModel {
 public:
  NoiseModel(const SensorArray& array, const HallArrayConfiguration& configuration);

  // `field` over sensors: all x, all y, all z. Unusable channels get the identity's row.
  void covariance(const CleanReading& reading, const Eigen::VectorXd& field,
                  SensorMatrices& covariance) const;

 private:
  const SensorArray& array_;
  double constant_variance_;   // tesla^2
  double gain_variance_;       // relative^2
  double alignment_variance_;  // rad^2
};

// Each sensor's reading z as information about the field B at its place: with the response R and
// the covariance V, the weighted misfit is (z - R B)^T V^-1 (z - R B) = c - B.(2 h - G B).
struct FieldInformation {
  explicit FieldInformation(Eigen::Index num_sensors);

  SensorMatrices matrix;   // G = R^T V^-1 R, 1 / tesla^2
  Eigen::VectorXd vector;  // h = R^T V^-1 z: all x, all y, all z
  Eigen::VectorXd scalar;  // c = z^T V^-1 z
};
// Fills `information`, which must have the array's size.
void inform(const SensorArray& array, const CleanReading& reading, const SensorMatrices& covariance,
            FieldInformation& information);

// `out` = G `in` at every sensor; both point to all x, all y, all z.
void apply_information(const SensorMatrices& matrix, const double* in, double* out);

// Each sensor's share of the weighted misfit in a given field.
void sensor_misfits(const FieldInformation& information, const Eigen::VectorXd& field,
                    Eigen::VectorXd& misfits);

// Sums over sensors of G and of h - G B: the normal equations of a uniform field on top of `field`.
void sum_up(const FieldInformation& information, const Eigen::VectorXd& field,
            Eigen::Matrix3d& matrix, Eigen::Vector3d& vector);

// Rough field at the sensors straight from the readings, for weighing when nothing better is known.
Eigen::VectorXd measured_field(const SensorArray& array, const CleanReading& reading);

}  // namespace gastronaut::magnetics

// What is unknown in a reading of the Hall array, and in which order.
#pragma once

#include <Eigen/Core>

namespace gastronaut::magnetics {

struct MagnetState {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();    // metres, magnet centre
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();       // unit, direction of the moment
  double moment = 0;                                     // A m^2
  Eigen::Vector3d background = Eigen::Vector3d::Zero();  // tesla, uniform
};

// Places of the unknowns in gradients and covariances. The axis has two: rotations about the
// columns of perpendicular_basis(axis).
inline constexpr int kPosition = 0;
inline constexpr int kRotation = 3;
inline constexpr int kMoment = 5;
inline constexpr int kBackground = 6;
inline constexpr int kNumUnknowns = 9;
// The first kBackground unknowns belong to the magnet and need derivatives of its field.
inline constexpr int kNumMagnetUnknowns = kBackground;

using UnknownVector = Eigen::Matrix<double, kNumUnknowns, 1>;
using UnknownMatrix = Eigen::Matrix<double, kNumUnknowns, kNumUnknowns>;

// The state moved by `step`; the axis stays a unit vector.
MagnetState moved(const MagnetState& state, const UnknownVector& step);

}  // namespace gastronaut::magnetics

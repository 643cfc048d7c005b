// Which part of an array's readings a uniform field makes: what offsets and background share.
#pragma once

#include <Eigen/Core>
#include <Eigen/QR>

namespace gastronaut {

// Field (tesla, rig frame) whose readings through `responses` (channels x 3) come nearest to
// `values`. Directions that the array hardly responds to (across a mono-axial array) get none.
inline Eigen::Vector3d uniform_field(const Eigen::MatrixXd& responses,
                                     const Eigen::VectorXd& values) {
  Eigen::CompleteOrthogonalDecomposition<Eigen::MatrixXd> decomposition;
  constexpr double kHardly = 0.1;  // of the direction that it responds to most
  decomposition.setThreshold(kHardly);
  decomposition.compute(responses);
  return decomposition.solve(values);
}

}  // namespace gastronaut

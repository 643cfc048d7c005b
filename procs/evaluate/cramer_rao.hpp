// The best that any unbiased estimator can do with one reading of the Hall array: the Cramer-Rao
// bound (J^T S^-1 J + priors)^-1 of the magnet's position and axis, with the uniform background as
// an unknown, and the moment too where the localiser estimates it.
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "configuration/rig_configuration.hpp"
#include "geometry/se3.hpp"

namespace gastronaut::evaluation {

class CramerRaoBound {
 public:
  enum class Noise {
    kConfigured,  // sensor noise and what the configuration says calibration leaves: gain,
                  // alignment, offset, and the measured coil currents' noise
    kSensorOnly,  // sensor noise alone, as if the calibration were perfect
  };
  CramerRaoBound(const RigConfiguration& configuration, Noise noise);

  // Covariance of position (m^2, rig frame) and of two rotations (rad^2) about
  // perpendicular_basis(axis), for a magnet at `position` with the unit `axis`. Channels are
  // counted sensor by sensor; those in `unused` (ascending) tell nothing. Not positive definite
  // readings (too few channels) give infinite variances.
  Matrix5d covariance(const Eigen::Vector3d& position, const Eigen::Vector3d& axis,
                      std::span<const int> unused = {}) const;

 private:
  std::vector<HallSensorConfiguration> sensors_;
  Eigen::MatrixXd current_effect_;  // channels x coils: tesla per sigma of each current
  double moment_ = 0;
  double octupole_ratio_ = 0;
  double noise_variance_ = 0;  // tesla^2, offset included
  double gain_std_ = 0;
  double alignment_std_ = 0;
  double background_std_ = 0;
  double moment_std_ = 0;  // zero: the moment is no unknown
};

}  // namespace gastronaut::evaluation

// The full-field estimator: all readings as they are, the uniform background as an unknown.
// Minimises sum over sensors of (z - R B)^T V^-1 (z - R B).
#pragma once

#include "magnetic_localizer/magnet_fit.hpp"
#include "magnetic_localizer/magnet_model.hpp"

namespace gastronaut::magnetics {

class FullField : public Estimator {
 public:
  FullField(const SensorArray& array, const MagnetModel& model);

  void set_reading(const CleanReading& reading, const SensorMatrices& covariance,
                   const FieldInformation& information) override;
  void evaluate(const MagnetState& state, NormalEquations& equations) override;
  int num_observations() const override { return num_observations_; }
  bool fits_background() const override { return true; }
  Eigen::Vector3d centre() const override { return centre_; }

 private:
  const MagnetModel& model_;
  Eigen::Vector3d centre_;
  const FieldInformation* information_ = nullptr;
  int num_observations_ = 0;
  double scalar_ = 0;                  // sum of the information's scalars
  Eigen::Matrix3d background_matrix_;  // sum of its matrices
  // Workspace.
  ArrayField field_;
  Eigen::VectorXd residual_;                                            // h - G B
  Eigen::Matrix<double, Eigen::Dynamic, kNumMagnetUnknowns> weighted_;  // G J
};

}  // namespace gastronaut::magnetics

// The paper's estimator: second-order directional differentiation.
//
// Off its sources every component of the field is harmonic, so the planar array's second
// differences over its grid give the second derivative across its plane,
//   d2B/dn2 = -(d2B/drow2 + d2B/dcol2),
// by the five-point stencil around each interior sensor. A uniform background and uniform
// gradients cancel exactly; what is left is the magnet, and noise that neighbouring stencils
// share. Model and reading go through the same differences, so the grid's coarseness is no error.
#pragma once

#include <Eigen/Cholesky>
#include <Eigen/SparseCore>
#include <vector>

#include "magnetic_localizer/magnet_fit.hpp"
#include "magnetic_localizer/magnet_model.hpp"

namespace gastronaut::magnetics {

class SecondDifference : public Estimator {
 public:
  // Throws ConfigurationError where the sensors are no regular grid of at least 3 x 3.
  SecondDifference(const SensorArray& array, const MagnetModel& model,
                   const HallArrayConfiguration& grid, double background_std);

  // Stencils with an unusable channel are left out.
  void set_reading(const CleanReading& reading, const SensorMatrices& covariance,
                   const FieldInformation& information) override;
  void evaluate(const MagnetState& state, NormalEquations& equations) override;
  int num_observations() const override { return static_cast<int>(observed_.size()); }
  bool fits_background() const override { return false; }
  Eigen::Vector3d centre() const override { return centre_; }

 private:
  using RowMajorMatrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

  Eigen::Index num_sensors_;
  Eigen::Index num_axes_;
  const MagnetModel& model_;
  Eigen::Vector3d centre_;
  double background_std_;
  // A row a stencil and component, a column a channel: readings to differences.
  Eigen::SparseMatrix<double, Eigen::RowMajor> differences_;
  // The same from field components at the sensors.
  Eigen::SparseMatrix<double, Eigen::RowMajor> field_differences_;
  // Differences that the last reading allows.
  Eigen::SparseMatrix<double, Eigen::RowMajor> used_field_differences_;
  Eigen::VectorXd observed_;           // whitened
  Eigen::LLT<Eigen::MatrixXd> noise_;  // of the used differences
  ArrayField field_;
};

}  // namespace gastronaut::magnetics

// Levenberg-Marquardt for the magnet's pose, whatever the estimator makes of the reading.
#pragma once

#include "magnetic_localizer/magnet_state.hpp"
#include "magnetic_localizer/noise_model.hpp"
#include "magnetic_localizer/sensor_array.hpp"

namespace gastronaut::magnetics {

// Weighted squared misfit of a state, half its negative gradient J^T W r and its information
// J^T W J.
struct NormalEquations {
  UnknownMatrix information = UnknownMatrix::Zero();
  UnknownVector gradient = UnknownVector::Zero();
  double misfit = 0;
};

// What an estimator compares between reading and model: the field itself (full_field.hpp) or its
// second differences over the grid (second_difference.hpp).
class Estimator {
 public:
  virtual ~Estimator() = default;
  // The reading that the next evaluations are about, with everything that is known of its noise;
  // `information` says the same as `reading` with `covariance`.
  virtual void set_reading(const CleanReading& reading, const SensorMatrices& covariance,
                           const FieldInformation& information) = 0;
  virtual void evaluate(const MagnetState& state, NormalEquations& equations) = 0;
  // How many numbers are compared.
  virtual int num_observations() const = 0;
  // Whether the background is among the unknowns that they determine.
  virtual bool fits_background() const = 0;
  // Unknowns that the comparison determines.
  int num_fitted() const { return kMoment + (fits_background() ? 3 : 0); }
  // Middle of the array, metres.
  virtual Eigen::Vector3d centre() const = 0;
};

// What is known before the reading.
struct Prior {
  double moment = 0;          // A m^2
  double moment_std = 0;      // 0: exactly known
  double background_std = 0;  // tesla, about zero, per axis
};

struct MagnetFit {
  MagnetState state;
  UnknownMatrix covariance = UnknownMatrix::Zero();  // (J^T W J + priors)^-1; converged fits only
  double misfit = 0;                                 // priors included
  bool converged = false;
};

MagnetFit fit_magnet(Estimator& estimator, const Prior& prior, const MagnetState& start);

}  // namespace gastronaut::magnetics

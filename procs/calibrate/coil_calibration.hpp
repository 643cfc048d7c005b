// The coils' current-to-field matrix and the sensors' offsets from readings without the capsule.
//
// Channel by channel, reading = C I + offset by linear regression on the readings that a robust fit
// (Tukey's biweight) finds good. The currents are measured with noise, which pulls the estimate
// towards zero: the normal matrix is corrected by the noise's covariance (Fuller, Measurement Error
// Models, 1987, section 2.2), and the pull that was corrected is reported. The offset contains the
// uniform background.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "calibrate/calibration_readings.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

struct CoilCalibration {
  Eigen::MatrixXd tesla_per_ampere;  // channels x coils
  Eigen::MatrixXd tesla_per_ampere_std;
  Eigen::VectorXd offsets;  // tesla, background included
  Eigen::VectorXd offset_stds;
  Eigen::VectorXd residual_rms;   // tesla, one a channel
  Eigen::VectorXd drive;          // ampere, one a coil: part of its current that is its own, rms
  Eigen::VectorXd current_noise;  // ampere, one a coil, as measured
  double largest_attenuation =
      0;                        // relative; what the noise would have taken off without correction
  double outlier_fraction = 0;  // of the readings, channel by channel
  int readings_used = 0;
};

// Noise of each current (ampere) from the third differences of its samples (one row a sample):
// smooth drive cancels, and the median ignores the steps of a switched one.
Eigen::VectorXd measure_current_noise(const Eigen::MatrixXd& samples);

// `rig`, where known, tells where the sensors are, so that a magnet within their reach is noticed
// also when it does not move. Channels come num_axes a sensor; sensors and coils are counted from
// zero in messages. Throws CalibrationRefused.
CoilCalibration calibrate_coils(const std::vector<CalibrationReading>& readings,
                                Eigen::Index num_axes, const Eigen::VectorXd& current_noise,
                                const std::optional<RigConfiguration>& rig);

// `rig` with the matrix, the offsets (less the uniform background, which goes to `background`) and
// the mean current noise.
RigConfiguration with_coils(const RigConfiguration& rig, const CoilCalibration& calibration,
                            Eigen::Vector3d* background);

}  // namespace gastronaut

// Joint least squares over the magnet's poses and the array's parameters.
//
// Channel c of reading t is modelled as
//   r_c . (M B(p_t, a_t) + b) + (C_c + D_c)(I_t + e_t) + o_c
// with the response row r_c, offset o_c, magnet pose (p_t, a_t), moment M, uniform background b
// (constant over the log), coil matrix row C_c as configured, its error D_c (what gain and
// alignment errors of the sensor do to it: a matrix that was computed, or measured with other
// sensors, does not know of them) and the error e_t of the measured currents. Every unknown but the
// poses has a Gaussian prior; known poses have one too. Background and offsets are told apart by
// their priors alone (the common part goes to the background), as are the moment and the mean gain;
// neither split matters to a localiser that estimates the background and is given both moment and
// gains.
//
// Given the array, the readings are independent of each other: Levenberg-Marquardt steps eliminate
// pose and current errors reading by reading (Schur complement), and what is left is a dense system
// in the array's parameters, whose inverse is their posterior covariance with the poses
// marginalised.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "calibrate/calibration_readings.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

// One sigma of what is believed before the log is seen.
struct ArrayPriors {
  double gain_std = 0.01;
  double alignment_std = 0.0175;     // radians: one degree
  double offset_std = 5e-6;          // tesla
  double known_position_std = 1e-4;  // metres: of poses that are given
  double known_axis_std = 1e-3;      // radians
};

class JointArrayFit {
 public:
  // `starts`: where each reading's magnet is; for readings with a known pose, that pose.
  JointArrayFit(const RigConfiguration& rig, const ArrayPriors& priors,
                std::vector<CalibrationReading> readings, std::vector<MagnetPose> starts);

  // Iterates from where it stands; progress gets 0..1. False: it did not converge, and there are no
  // deviations.
  bool solve(const std::function<void(double)>& progress);

  // The configuration with the estimates in it: responses, offsets, moment, coil matrix. Its
  // *_std fields still are the configured ones.
  RigConfiguration rig() const;
  Eigen::Vector3d background() const;  // tesla
  const std::vector<MagnetPose>& poses() const { return state_.poses; }
  // A better place for reading t's magnet to go on from.
  void move_pose(std::size_t reading, const MagnetPose& pose);
  // Of data and priors, per degree of freedom; 1 where the noise is what it is configured to be.
  double chi2_per_dof() const;
  // Typical residual (median, scaled to one sigma of normal ones) in units of the configured noise.
  double residual_scale() const;

  // Posterior standard deviations, without the factor sqrt(chi2_per_dof). Valid after solve().
  struct ChannelDeviation {
    double gain = 0;       // relative
    double alignment = 0;  // radians, root mean square of both directions
    // tesla, of the reading without magnet and currents, less what a uniform field makes of it:
    // offset and response to the background are known far better together than each
    double offset = 0;
  };
  std::vector<ChannelDeviation> channel_deviations() const;
  double moment_deviation() const;  // A m^2

  // Error of a fix of reading t's magnet that the array's parameters cause, as one sigma of
  // position (metres, norm) and axis (radians, norm), with their prior and with their posterior.
  struct InducedError {
    double prior_position = 0;
    double prior_axis = 0;
    double position = 0;
    double axis = 0;
  };
  InducedError induced_error(std::size_t reading) const;

 private:
  struct Decoded;  // the array's parameters in physical units
  struct State {
    Eigen::VectorXd array;  // in units of the prior's sigma
    std::vector<MagnetPose> poses;
    Eigen::MatrixXd current_errors;  // num_coils x readings, in sigmas
  };
  struct PosePrior {
    MagnetPose pose;
    double position_std;
    double axis_std;
  };
  PosePrior pose_prior(std::size_t reading) const;
  Decoded decode(const Eigen::VectorXd& array) const;
  double cost(const State& state) const;
  void assemble(const State& state, double damping);
  State stepped(const State& state) const;
  // Rows of the reading's channels: residual (sigmas) and derivatives by its pose and current
  // errors, by its channel's parameters, by the globals.
  struct Rows {
    Eigen::VectorXd residual;
    Eigen::MatrixXd by_local;
    Eigen::MatrixXd by_channel;
    Eigen::MatrixXd by_global;
  };
  Rows linearize(const Decoded& array, const MagnetPose& pose, const Eigen::VectorXd& current_error,
                 const CalibrationReading& reading) const;

  RigConfiguration rig_;
  ArrayPriors priors_;
  std::vector<HallSensorConfiguration> sensors_;
  std::vector<CalibrationReading> readings_;
  std::vector<MagnetPose> starts_;
  Eigen::Index num_axes_;
  Eigen::Index num_channels_;
  Eigen::Index num_coils_;
  // Patterns of a channel's coil row error, one a row, each for one sigma. Three axes: gain and
  // alignment mix the sensor's own rows. One axis: what alignment mixes in is not known, so each
  // coil errs by itself.
  std::vector<Eigen::MatrixXd> coil_errors_;
  Eigen::Index per_channel_;  // parameters: response 3, offset 1, coil row error
  Eigen::Index per_reading_;  // position 3, axis 2, current errors
  Eigen::Index num_array_;    // all channels' parameters, then moment and background
  double octupole_ratio_;

  State state_;
  double cost_ = 0;
  // The linear system of the last assemble().
  Eigen::MatrixXd reduced_;      // Schur complement, lower triangle
  Eigen::VectorXd gradient_;     // of the array's parameters, reduced
  Eigen::MatrixXd eliminated_;   // stacked L_t^-1 W_t
  Eigen::VectorXd local_right_;  // stacked L_t^-1 g_t
  std::vector<Eigen::MatrixXd> local_factors_;
  Eigen::MatrixXd covariance_;
};

}  // namespace gastronaut

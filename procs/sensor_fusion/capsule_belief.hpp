// What one history of sensor failures makes of the capsule: a Gaussian over its pose and motion and
// over everything that stands between the sensors, conditioned on which measurements were good.
// All of that is nearly linear, so it is filtered (an extended Kalman filter on the error state)
// instead of sampled: the Rao-Blackwellised part of the particle filter (switching_filter.hpp).
//
// Error state, 31 numbers, true = estimate (+) error:
//   position            of the magnet's centre, rig frame, metres
//   rotation            rig_R_camera * exp(error): camera frame, radians
//   velocity            of the magnet's centre, rig frame, metres a second
//   turn                angular velocity, rig frame, radians a second
//   map position        rig_T_map of position = map position + scale * rig_R_map * (VISUAL_POSE);
//                       map frame, metres of the rig
//   map rotation        rig_R_map * exp(error): map frame
//   map scale           scale * exp(error)
//   position bias       of the magnetic fix, rig frame: what the array's calibration leaves
//   axis bias           rotation vector, rig frame, likewise
//   magnet position     magnet's centre, camera frame: what `calibrate hand-eye` leaves
//   magnet axis         two rotations about perpendicular_basis(axis), camera frame
//   time offset         seconds that a magnetic reading was taken after its utime
// In these coordinates a roll about the magnet's axis, vision's map with it, is the same
// combination of errors whatever the estimate, as long as vision sees no motion. With the camera's
// position, its angular velocity in its own frame, or the map's errors in the rig frame, noise in
// the estimate would seem to tell of the roll, and it would be taken for known in the end (the
// inconsistency that first-estimate Jacobians mend: Huang, Mourikis, Roumeliotis 2008).
#pragma once

#include <Eigen/Core>

#include "geometry/se3.hpp"

namespace gastronaut::fusion {

enum ErrorIndex : int {
  kPosition = 0,
  kRotation = 3,
  kVelocity = 6,
  kTurn = 9,
  kMapPosition = 12,
  kMapRotation = 15,
  kMapScale = 18,
  kPositionBias = 19,
  kAxisBias = 22,
  kMagnetPosition = 25,
  kMagnetAxis = 28,
  kTimeOffset = 30,
  kErrorSize = 31,
  kCalibration = kMagnetPosition,  // these and what follows
  kCalibrationSize = kErrorSize - kCalibration
};

using ErrorVector = Eigen::Matrix<double, kErrorSize, 1>;
using ErrorMatrix = Eigen::Matrix<double, kErrorSize, kErrorSize>;

// How the capsule moves, and how the sensors err beyond what they say of themselves.
struct BeliefModel {
  // Velocities fade with this time constant and are driven by white noise: constant velocity over
  // the gap between two measurements, at rest in the end when nothing is heard any more.
  double velocity_memory = 5;             // seconds
  double turn_memory = 2;                 // seconds
  double acceleration_std = 0.02;         // m/s^2 sqrt(s)
  double angular_acceleration_std = 0.3;  // rad/s^2 sqrt(s)
  // Part of the magnetic fix's variance that stays while the magnet stays where it is, at least:
  // how much more it is, the scatter of the fixes tells.
  double bias_share = 0.15;
  double bias_length = 0.05;  // metres of path after which it is another one,
  double bias_time = 60;      // or seconds
  // Vision, in distances to what the camera sees (its errors are those of the wall's picture):
  // white from frame to frame, and drifting with the square root of the path.
  double working_distance = 0.04;  // metres
  double visual_rotation_std = 8e-4;
  double visual_position_std = 6e-4;
  double drift_rotation = 6e-3;  // radians over a path of one distance
  double drift_position = 3e-3;  // distances, likewise
  double drift_scale = 5e-3;
};

// One linearised measurement: residual = jacobian * error + noise.
struct Innovation {
  static constexpr int kMost = 6;
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMost, 1> residual;
  Eigen::Matrix<double, Eigen::Dynamic, kErrorSize, Eigen::RowMajor, kMost, kErrorSize> jacobian;
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMost, kMost> noise;
};

// How well an innovation fits, and what it does to the belief.
struct Gain {
  // Of the residual, natural logarithm; minus infinity where it cannot be told, and then the gain
  // does nothing.
  double log_density = 0;
  double chi2 = 0;     // residual^T S^-1 residual
  double log_det = 0;  // of 2 pi S
  Eigen::Matrix<double, kErrorSize, Eigen::Dynamic, 0, kErrorSize, Innovation::kMost> half;
  Eigen::Matrix<double, Eigen::Dynamic, 1, 0, Innovation::kMost, 1> whitened;
};

struct MagneticFix {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // metres, rig frame
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();     // unit, rig frame
  // Position m^2, then two rotations rad^2 about perpendicular_basis(axis).
  Matrix5d covariance = Matrix5d::Identity();
};

struct CapsuleBelief {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Quaterniond rig_R_camera = Eigen::Quaterniond::Identity();
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();
  SE3 rig_T_map;
  double map_scale = 1;
  bool has_map = false;  // rig_T_map is known as well as its covariance says
  Eigen::Vector3d position_bias = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis_bias = Eigen::Vector3d::Zero();
  Eigen::Vector3d magnet_position = Eigen::Vector3d::Zero();
  Eigen::Vector3d magnet_axis = Eigen::Vector3d::UnitZ();
  double time_offset = 0;
  // Whether measurements teach magnet_position, magnet_axis and time_offset too. Else their errors
  // are taken into account, and left as they are (a Schmidt-Kalman filter): what vision's drift
  // would make of them in a minute is worse than a calibration.
  bool learns_calibration = false;
  ErrorMatrix covariance = ErrorMatrix::Zero();

  // After `elapsed` seconds; `bias_covariance` is that of position_bias and axis_bias in the long
  // run.
  void predict(double elapsed, const BeliefModel& model, const Matrix6d& bias_covariance);

  // Position, and where `with_axis` the axis, of the magnet; the part `scatter` of the fix's
  // variance is its own, the rest a bias.
  Innovation observe_magnet(const MagneticFix& fix, double scatter, bool with_axis) const;
  // The camera in the map, noise of (translation, rotation) in the camera frame; where
  // `rotation_only` its rotation in a map whose rotation is taken as known.
  Innovation observe_camera(const SE3& map_T_camera, const Matrix6d& noise,
                            bool rotation_only) const;
  Gain weigh(const Innovation& innovation) const;
  void update(const Gain& gain);

  // Vision has drifted by noise of this covariance (translation, rotation; camera frame), its scale
  // by this variance.
  void let_map_drift(const Matrix6d& noise, double scale_variance);
  // Makes rig_T_map what puts the camera where it is thought to be; the scale stays.
  void establish_map(const SE3& map_T_camera, const Matrix6d& noise);
  // Turned about the magnet's axis by `angle`, the variance of which becomes `variance`; the map is
  // forgotten.
  CapsuleBelief rolled(double angle, double variance) const;

  SE3 rig_T_camera() const { return {rig_R_camera, position - rig_R_camera * magnet_position}; }
  Eigen::Vector3d axis_in_rig() const { return rig_R_camera * magnet_axis; }
  // Of the camera: translation (rig frame), rotation (camera frame).
  Matrix6d pose_covariance() const;
  Eigen::Vector3d camera_velocity() const {
    return velocity - turn.cross(rig_R_camera * magnet_position);
  }

  void add(const ErrorVector& error);

 private:
  // How errors of the belief move the camera, rig frame.
  Eigen::Matrix<double, 3, kErrorSize> camera_jacobian() const;
};

// Noise of vision in its own camera frame: rotations of that size swing the camera about what it
// sees at `distance` in front of it. Translation m^2, rotation rad^2.
Matrix6d swinging_noise(double position_std, double rotation_std, double distance);

}  // namespace gastronaut::fusion

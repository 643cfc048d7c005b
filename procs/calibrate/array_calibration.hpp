// Calibrates the Hall array and the magnet's moment from readings in which the magnet moves:
// selects readings, starts the joint fit (joint_array_fit.hpp), checks its result on a part of the
// log that it has not seen, and refuses a log that cannot determine the array.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "calibrate/calibration_readings.hpp"
#include "calibrate/joint_array_fit.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

struct ArrayCalibrationOptions {
  ArrayPriors priors;
  int most_readings = 400;  // that go into the fit, evenly from the log
};

struct ArrayCalibration {
  // The configured rig with responses, offsets, moment and coil matrix as estimated, and gain_std,
  // alignment_std, offset_std and moment_std as what is left unknown of them.
  RigConfiguration rig;
  std::vector<JointArrayFit::ChannelDeviation> deviations;
  Eigen::Vector3d background = Eigen::Vector3d::Zero();  // tesla
  double chi2_per_dof = 0;
  int readings_used = 0;
  int readings_left_out = 0;  // magnet not found, or another field beside it
  // Root mean square residual of single fixes, tesla, on held-out stretches of the log.
  int held_out = 0;
  double held_out_rms_before = 0;
  double held_out_rms_after = 0;
  // Root mean square over the log's poses of what the array's errors do to a fix.
  JointArrayFit::InducedError induced;
};

// `readings` in order of time. Throws CalibrationRefused.
ArrayCalibration calibrate_array(const RigConfiguration& rig,
                                 const std::vector<CalibrationReading>& readings,
                                 const ArrayCalibrationOptions& options,
                                 const std::function<void(double)>& progress);

}  // namespace gastronaut

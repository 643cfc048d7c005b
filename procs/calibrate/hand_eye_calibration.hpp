// Calibrates how the magnet sits in the camera's frame from a log of motions.
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include "calibrate/hand_eye_model.hpp"
#include "calibrate/hand_eye_motion.hpp"
#include "calibrate/hand_eye_solver.hpp"

namespace gastronaut {

struct HandEyeCalibration {
  HandEye estimate;
  HandEyeMatrix covariance = HandEyeMatrix::Zero();
  HandEyeNoise noise;       // what neighbouring poses share, as the residuals show
  double chi2_per_dof = 0;  // under that noise; the covariance is scaled by it where it is above 1
  double position_rms = 0;  // metres, residual of the poses that fit
  double axis_rms = 0;      // radians
  std::size_t poses = 0;
  std::size_t misfits = 0;  // of them, that do not fit and count for little
  std::size_t fixes = 0;    // in these poses
  // One sigma of centre and axis from leaving out each pose, or each of 20 parts of the log
  // (jackknife), and the furthest that one of them moves the centre (metres) and axis (radians).
  std::size_t parts = 0;
  Vector5d jackknife_std = Vector5d::Zero();
  double centre_shift = 0;
  double axis_shift = 0;
  HandEyeAdvice advice;
};

// `fixes` in order of time. `configured` is one of many starts for centre and axis, and where the
// time offset is looked for. progress gets 0..1. Throws CalibrationRefused when the motion leaves
// centre or axis unknown, saying which motion would tell, or when most poses contradict each other.
HandEyeCalibration calibrate_hand_eye(const VisualTrack& track,
                                      const std::vector<MagneticFix>& fixes,
                                      const HandEye& configured,
                                      const std::function<void(double)>& progress);

}  // namespace gastronaut

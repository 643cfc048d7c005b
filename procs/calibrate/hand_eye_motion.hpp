// Says in plain words what a hand-eye calibration knows least, and which motion would tell it.
#pragma once

#include <array>
#include <string>

#include "calibrate/hand_eye_model.hpp"

namespace gastronaut {

// What a calibration is good enough for (targets.md), one sigma.
inline constexpr double kCentreTarget = 3e-4;                // metres
inline constexpr double kAxisTarget = 5.235987755982989e-3;  // radians: 0.3 degree

struct HandEyeAdvice {
  double sigma = 0;     // of the weakest direction, in units of the targets
  std::string weakest;  // "the magnet's centre along the camera's x axis, +-0.21 mm"
  std::array<int, 3> more_poses = {0, 0, 0};  // turned about the camera's x, y, z axes
  bool enough = true;                         // so many poses reach the targets
  std::string motion;  // "rotate about the camera's x axis, 3 more poses"; empty: none is needed
};

// `covariance` of all unknowns. New poses are imagined 30 degrees to either side of `pose`, each
// with errors of `pose_covariance` as HandEyeRow's, one by one where they tell most.
HandEyeAdvice advise(const HandEye& hand_eye, const HandEyeMatrix& covariance, const SE3& pose,
                     const Matrix5d& pose_covariance);

}  // namespace gastronaut

// What a hand-eye calibration hands back: a configuration fragment and a table.
#pragma once

#include <string>

#include "calibrate/hand_eye_calibration.hpp"

namespace gastronaut {

// `configured`: camera_T_magnet as it was, for comparison.
std::string hand_eye_table(const HandEyeCalibration& calibration, const SE3& configured);
std::string hand_eye_fragment(const HandEyeCalibration& calibration, const SE3& configured,
                              const std::string& log);

}  // namespace gastronaut

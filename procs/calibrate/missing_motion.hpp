// Says in plain words which motion of the magnet a log lacks for calibrating the array.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "calibrate/calibration_readings.hpp"

namespace gastronaut {

// "sensors 3, 40-47 (+x side)": numbers with runs joined, and where most of them lie, as seen from
// the array's centre; no side is named when they lie all over it.
std::string name_sensors(const std::vector<int>& sensors,
                         const std::vector<Eigen::Vector3d>& positions);

// One sentence for each motion that is missing: rotations that keep the axis within a narrow cone,
// a path that is short against the array. Empty when neither is.
std::vector<std::string> describe_missing_motion(const std::vector<MagnetPose>& poses,
                                                 const std::vector<Eigen::Vector3d>& positions);

}  // namespace gastronaut

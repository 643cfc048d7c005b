// Trajectory files of the TUM RGB-D benchmark (time x y z qx qy qz qw, seconds and metres) and of
// KITTI odometry (the twelve numbers of a 3x4 matrix a row, no time).
#pragma once

#include <string>

#include "trajectory/stamped_poses.hpp"

namespace gastronaut {

enum class TrajectoryFormat { kTum, kKitti };

// Throws std::runtime_error naming file and line for what is not a pose; comments (#) and empty
// lines are skipped. Poses are sorted by time; of several at one time the last one counts, as in
// the TUM benchmark's tools. KITTI poses get their row number as utime.
StampedPoses read_trajectory(const std::string& path, TrajectoryFormat format);

// Throws std::runtime_error when the file cannot be written.
void write_tum(const std::string& path, const StampedPoses& trajectory);

}  // namespace gastronaut

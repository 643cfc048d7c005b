// A recording read from somebody's files, ready to be written as a log.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "configuration/rig_configuration.hpp"
#include "import/frame_source.hpp"
#include "import/pose_table.hpp"
#include "import/timeline.hpp"

namespace gastronaut {

struct StampedPose {
  std::int64_t utime = 0;  // microseconds
  SE3 rig_T_camera;
};

enum class DepthKind {
  kGroundTruth,  // exact: rendered
  kSensor,       // what a depth camera measured
};

struct Recording {
  RigConfiguration rig;
  std::unique_ptr<FrameSource> frames;
  DepthKind depth_kind = DepthKind::kGroundTruth;
  double depth_relative_std = 0;   // one sigma, as a fraction of the depth
  Series hall;                     // tesla, sensor by sensor, its axes in order
  Series coil_currents;            // ampere
  std::vector<StampedPose> poses;  // ascending
};

// Poses in ascending order of time. `seconds_per_frame` times those that only have a frame number.
std::vector<StampedPose> make_poses(const PoseTable& table, double seconds_per_frame, double epoch,
                                    const std::string& name, Issues& issues);

// Reads a table of `columns` numbers after the time. Throws std::runtime_error when the file cannot
// be read or has no good row.
Series read_series(const std::string& path, std::size_t columns, double epoch, Issues& issues);
std::vector<StampedPose> read_poses(const std::string& path, double seconds_per_frame, double epoch,
                                    Issues& issues);

}  // namespace gastronaut

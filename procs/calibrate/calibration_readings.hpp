// What the calibrations read: plain values, whatever log or simulation they came from.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <vector>

namespace gastronaut {

// Centre (metres) and direction of the moment (unit) of the magnet in the rig frame.
struct MagnetPose {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();
};

// One reading of the whole array with the coils' currents at that moment.
struct CalibrationReading {
  std::int64_t utime = 0;    // microseconds
  Eigen::VectorXd field;     // tesla, channel by channel: sensor by sensor, its axes in order
  std::vector<bool> usable;  // one a channel: neither saturated nor stale nor faulty
  Eigen::VectorXd currents;  // ampere, one a coil; empty: no coils
  std::optional<MagnetPose> known_pose;
};

// The log cannot determine what was asked for. The text says why and what to record instead.
class CalibrationRefused : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

}  // namespace gastronaut

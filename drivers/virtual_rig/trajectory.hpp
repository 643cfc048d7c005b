// Where the capsule is at any time: smooth paths inside the organ that look at its wall, the walk
// of a magnet below the array that calibrates it, and that of a camera before a card.
#pragma once

#include <cstdint>
#include <optional>

#include "geometry/se3.hpp"
#include "virtual_rig/centreline.hpp"
#include "virtual_rig/scenario.hpp"

namespace gastronaut {

class Trajectory {
 public:
  // Throws ConfigurationError when no tour of the wanted length fits into the organ.
  Trajectory(const TrajectoryConfiguration& trajectory, const Centreline& centreline,
             const SE3& camera_T_magnet, std::uint64_t seed);

  // rig_T_camera at `time` (seconds from the start, any); nothing: there is no capsule.
  std::optional<SE3> pose(double time) const;

 private:
  SE3 tour(double phase) const;
  SE3 light_calibration(double phase) const;
  SE3 array_calibration(double time) const;
  SE3 calibration_place(std::uint64_t index) const;
  double tour_length() const;

  TrajectoryConfiguration trajectory_;
  Centreline centreline_;
  SE3 magnet_T_camera_;
  std::uint64_t seed_;
  int laps_ = 1;      // there and back so many times in one period
  double scale_ = 1;  // of everything that moves, so that the path has its length
};

}  // namespace gastronaut

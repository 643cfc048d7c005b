// A small rig made from physics alone: an array with sensor errors, a magnet on a path, coils that
// are dipoles below the table.
#pragma once

#include <functional>
#include <vector>

#include "calibrate/calibration_readings.hpp"
#include "calibrate/joint_array_fit.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

// An array 120 mm wide, 85 mm above the rig's origin, of 4 x 4 sensors with three axes or 8 x 8
// with one; four coils. Ideal sensors.
RigConfiguration simulated_rig(int num_axes);

// The rig as it really is: errors drawn from the priors. What the coils do to a sensor goes through
// its response.
RigConfiguration with_sensor_errors(const RigConfiguration& rig, const ArrayPriors& priors,
                                    std::uint64_t seed);

// A path all over the space below the array, with the axis turning every way. phase 0..1.
MagnetPose wide_path(double phase);

struct SimulatedRun {
  std::function<MagnetPose(double)> path;  // none: no magnet
  std::function<Eigen::VectorXd(double)> currents;
  Eigen::Vector3d background = {18e-6, -6e-6, -42e-6};  // tesla
  int readings = 150;
  std::uint64_t seed = 1;
  bool known_poses = false;
};

// Four independent currents of about 2 A.
Eigen::VectorXd independent_currents(double phase);

// What `truth` reads, with its noise on fields and on measured currents, 10 ms apart.
std::vector<CalibrationReading> simulate(const RigConfiguration& truth, const SimulatedRun& run);

}  // namespace gastronaut

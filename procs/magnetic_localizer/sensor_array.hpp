// The Hall array as contiguous arrays, and what one reading of it says.
//
// Every sensor has three axes here; those that a mono-axial sensor lacks have a response of zero
// and are never usable. Vectors over channels are stored axis by axis: all sensors' first axis,
// then all sensors' second, then third.
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>

#include "configuration/rig_configuration.hpp"

namespace gastronaut::magnetics {

struct SensorArray {
  explicit SensorArray(const HallArrayConfiguration& configuration);

  Eigen::Index channel(Eigen::Index sensor, Eigen::Index axis) const {
    return axis * num_sensors + sensor;
  }
  Eigen::Vector3d centre() const;

  Eigen::Index num_sensors = 0;
  Eigen::Index num_axes = 0;                // measured axes a sensor, 1 or 3
  std::array<Eigen::VectorXd, 3> position;  // x, y, z of all sensors, metres, rig frame
  std::array<Eigen::VectorXd, 9> response;  // [3 axis + k]: d reading / d B_k of all sensors
  Eigen::VectorXd offset;                   // tesla, channels
};

// A reading as it comes from the array.
struct HallReading {
  Eigen::VectorXd field;   // tesla, sensor by sensor, its axes in order
  Eigen::VectorXi status;  // one a sensor; 0: good
};

// A reading in which only the magnet, the background and noise are left. Over channels.
struct CleanReading {
  Eigen::VectorXd value;     // tesla
  Eigen::VectorXd variance;  // tesla^2, what the removal of the coil field added
  Eigen::VectorXd usable;    // 1, or 0: saturated, faulty, or no such axis
  int num_usable = 0;
};

// Takes sensor offsets and the coil field out of readings, and faulty channels out of use.
class ReadingCleaner {
 public:
  explicit ReadingCleaner(const RigConfiguration& configuration);

  // No currents: the coil field stays in. Sizes must fit the configuration.
  void clean(const HallReading& reading, const std::optional<Eigen::VectorXd>& currents,
             CleanReading& clean) const;

 private:
  SensorArray array_;
  double saturation_;
  double current_variance_;              // ampere^2
  double matrix_variance_;               // (tesla per ampere)^2
  Eigen::MatrixXd tesla_per_ampere_;     // over channels
  Eigen::VectorXd variance_by_current_;  // tesla^2 that the noise of the currents makes
};

}  // namespace gastronaut::magnetics

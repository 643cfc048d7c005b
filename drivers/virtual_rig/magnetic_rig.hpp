// The magnetic half of the virtual rig: what the Hall array reads and what the current meters say,
// with the sensors' true errors, and the configuration that a calibrated rig would publish.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "geometry/se3.hpp"
#include "virtual_rig/ring_magnet.hpp"
#include "virtual_rig/scenario.hpp"

namespace gastronaut {

// Bits of a sensor's status, those of hall_array_t.
inline constexpr std::int32_t kSensorSaturated = 1;
inline constexpr std::int32_t kSensorStale = 2;

struct HallReading {
  Eigen::VectorXd field;             // tesla, channel by channel: sensor by sensor, its axes
  std::vector<std::int32_t> status;  // one a sensor, 0 or the bits above
};

class MagneticRig {
 public:
  explicit MagneticRig(const VirtualRigScenario& scenario);

  // scenario.rig with the coil matrix as `calibrate coils` would measure it on these sensors.
  RigConfiguration published_configuration() const;
  // The rig as it truly is: sensors with their errors, exact coil matrix, true moment.
  RigConfiguration true_configuration() const;

  Eigen::Index num_coils() const { return true_matrix_.cols(); }
  // Ampere at `time` (seconds from the scenario's start), and as meter reading number `index`.
  Eigen::VectorXd true_currents(double time) const;
  Eigen::VectorXd measured_currents(std::int64_t index, double time) const;

  // Reading number `index` at `time`; no magnet: coils and background alone. Faulty sensors repeat
  // their last reading, so calls must come in the order of time.
  HallReading read(std::int64_t index, double time, const std::optional<SE3>& rig_T_magnet);

 private:
  Eigen::Vector3d foreign_field(const Eigen::Vector3d& point, double time) const;

  VirtualRigScenario scenario_;
  RingMagnet magnet_;
  double true_moment_;
  std::vector<HallSensorConfiguration> sensors_;  // true responses and offsets
  Eigen::MatrixXd true_matrix_;                   // tesla per ampere of every channel
  Eigen::MatrixXd measured_matrix_;
  Eigen::VectorXd last_;
};

}  // namespace gastronaut

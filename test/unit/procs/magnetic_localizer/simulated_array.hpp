// Readings of a Hall array from first principles: the magnet's field by common/magnetics (not by
// the localiser's own model), sensor errors, noise.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <numbers>

#include "configuration/rig_configuration.hpp"
#include "geometry/se3.hpp"
#include "magnetic_localizer/magnet_state.hpp"
#include "magnetic_localizer/sensor_array.hpp"
#include "magnetics/axial_magnet.hpp"
#include "numerics/counter_random.hpp"

namespace gastronaut::test {

// Draws one after another.
class Draws {
 public:
  Draws(std::uint64_t seed, std::uint64_t stream) : random_(seed, stream) {}
  double normal() { return random_.normal(next_++); }
  double uniform(double low, double high) { return low + (high - low) * random_.uniform(next_++); }
  Eigen::Vector3d direction() { return Eigen::Vector3d(normal(), normal(), normal()).normalized(); }

 private:
  CounterRandom random_;
  std::uint64_t next_ = 0;
};

// The rig of the paper: 8 x 8 sensors, no coils; a model that is exact but for white noise.
inline RigConfiguration exact_rig() {
  RigConfiguration rig;
  rig.magnet.moment_std = 0;
  rig.hall_array.gain_std = 0;
  rig.hall_array.alignment_std = 0;
  rig.hall_array.offset_std = 0;
  return rig;
}

// The sensors as they really are: the configured ones with errors of the configured size.
inline HallArrayConfiguration with_sensor_errors(const HallArrayConfiguration& configured,
                                                 std::uint64_t seed) {
  HallArrayConfiguration real = configured;
  real.sensors = configured.resolved_sensors();
  Draws draws(seed, 1);
  for (HallSensorConfiguration& sensor : real.sensors) {
    const Eigen::Vector3d turn(draws.normal(), draws.normal(), draws.normal());
    const Eigen::Matrix3d misalignment =
        so3_exp(configured.alignment_std * turn).toRotationMatrix();
    sensor.response = sensor.response * misalignment;
    for (Eigen::Index axis = 0; axis < configured.num_axes; ++axis) {
      sensor.response.row(axis) *= 1 + configured.gain_std * draws.normal();
      sensor.offset[static_cast<std::size_t>(axis)] += configured.offset_std * draws.normal();
    }
  }
  return real;
}

// A foreign magnet: a point dipole somewhere.
struct ForeignDipole {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();
};

inline magnetics::HallReading simulate_reading(const HallArrayConfiguration& array,
                                               const MagnetConfiguration& magnet,
                                               const magnetics::MagnetState& state, Draws* noise,
                                               const ForeignDipole& foreign = {}) {
  magnetics::HallReading reading;
  const Eigen::Index num_axes = array.num_axes;
  const auto sensors = array.resolved_sensors();
  reading.field.resize(num_axes * static_cast<Eigen::Index>(sensors.size()));
  reading.status.setZero(static_cast<Eigen::Index>(sensors.size()));
  Eigen::Index channel = 0;
  for (const HallSensorConfiguration& sensor : sensors) {
    Eigen::Vector3d field =
        axial_magnet_field(sensor.position - state.position, state.moment * state.axis,
                           octupole_ratio(magnet.shape())) +
        state.background;
    if (foreign.moment != Eigen::Vector3d::Zero()) {
      field += axial_magnet_field(sensor.position - foreign.position, foreign.moment, 0);
    }
    for (Eigen::Index axis = 0; axis < num_axes; ++axis, ++channel) {
      reading.field[channel] =
          sensor.response.row(axis).dot(field) + sensor.offset[static_cast<std::size_t>(axis)];
      if (noise != nullptr) reading.field[channel] += array.noise * noise->normal();
    }
  }
  return reading;
}

inline magnetics::MagnetState random_state(const RigConfiguration& rig, Draws& draws,
                                           double half_width, double least_depth,
                                           double most_depth) {
  magnetics::MagnetState state;
  state.position = {draws.uniform(-half_width, half_width), draws.uniform(-half_width, half_width),
                    rig.hall_array.z - draws.uniform(least_depth, most_depth)};
  state.axis = draws.direction();
  state.moment = rig.magnet.moment;
  state.background = Eigen::Vector3d(18e-6, -6e-6, -42e-6);  // tesla, like the Earth's
  return state;
}

// Error of a 5-DoF pose in the order of the covariance on the wire.
inline Vector5d pose_error(const Eigen::Vector3d& true_position, const Eigen::Vector3d& true_axis,
                           const magnetics::MagnetState& estimated) {
  Vector5d error;
  error.head<3>() = estimated.position - true_position;
  const Eigen::Vector3d turn =
      so3_log(Eigen::Quaterniond::FromTwoVectors(true_axis, estimated.axis));
  error.tail<2>() = perpendicular_basis(estimated.axis).transpose() * turn;
  return error;
}

}  // namespace gastronaut::test

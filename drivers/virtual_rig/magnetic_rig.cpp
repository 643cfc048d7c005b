#include "virtual_rig/magnetic_rig.hpp"

#include <array>
#include <cmath>
#include <numbers>

#include "magnetics/dipole.hpp"
#include "numerics/counter_random.hpp"
#include "virtual_rig/finite_coil.hpp"
#include "virtual_rig/random_streams.hpp"

namespace gastronaut {
namespace {

double draw_moment(const VirtualRigScenario& scenario) {
  const CounterRandom random(scenario.magnetics.rig_seed, stream_id(RandomStream::kMomentError));
  return scenario.rig.magnet.moment + scenario.magnetics.moment_error * random.normal(0);
}

std::vector<HallSensorConfiguration> draw_sensors(const VirtualRigScenario& scenario) {
  const MagneticsConfiguration& magnetics = scenario.magnetics;
  std::vector<HallSensorConfiguration> sensors = scenario.rig.hall_array.resolved_sensors();
  for (std::size_t i = 0; i < sensors.size(); ++i) {
    const CounterRandom random(scenario.magnetics.rig_seed,
                               stream_id(RandomStream::kSensorErrors, i));
    std::uint64_t n = 0;
    const Eigen::Vector3d turn(random.normal(n), random.normal(n + 1), random.normal(n + 2));
    n += 3;
    HallSensorConfiguration& sensor = sensors[i];
    sensor.response *= so3_exp(magnetics.alignment_error * turn).toRotationMatrix();
    for (Eigen::Index axis = 0; axis < sensor.response.rows(); ++axis) {
      sensor.response.row(axis) *= 1 + magnetics.gain_error * random.normal(n++);
      sensor.offset[static_cast<std::size_t>(axis)] += magnetics.offset_error * random.normal(n++);
    }
  }
  return sensors;
}

bool lists(const FaultConfiguration& fault, std::size_t sensor) {
  for (const int listed : fault.sensors) {
    if (static_cast<std::size_t>(listed) == sensor) return true;
  }
  return false;
}

}  // namespace

MagneticRig::MagneticRig(const VirtualRigScenario& scenario)
    : scenario_(scenario),
      magnet_(scenario.rig.magnet.shape(), draw_moment(scenario)),
      true_moment_(draw_moment(scenario)),
      sensors_(draw_sensors(scenario)) {
  const CoilGeometryConfiguration& coils = scenario.magnetics.coils;
  const Eigen::Index axes = scenario.rig.hall_array.num_axes;
  true_matrix_.resize(static_cast<Eigen::Index>(sensors_.size()) * axes, coils.rows * coils.cols);
  for (std::size_t i = 0; i < sensors_.size(); ++i) {
    true_matrix_.middleRows(static_cast<Eigen::Index>(i) * axes, axes) =
        sensors_[i].response * coil_fields(coils, sensors_[i].position);
  }
  measured_matrix_ = true_matrix_;
  const CounterRandom random(scenario.magnetics.rig_seed, stream_id(RandomStream::kMatrixError));
  for (Eigen::Index n = 0; n < measured_matrix_.size(); ++n) {
    measured_matrix_(n) +=
        scenario.magnetics.matrix_error * random.normal(static_cast<std::uint64_t>(n));
  }
  last_ = Eigen::VectorXd::Zero(true_matrix_.rows());
}

RigConfiguration MagneticRig::published_configuration() const {
  RigConfiguration rig = scenario_.rig;
  rig.coils.tesla_per_ampere = measured_matrix_;
  return rig;
}

RigConfiguration MagneticRig::true_configuration() const {
  RigConfiguration rig = scenario_.rig;
  rig.coils.tesla_per_ampere = true_matrix_;
  rig.hall_array.sensors = sensors_;
  rig.magnet.moment = true_moment_;
  return rig;
}

Eigen::VectorXd MagneticRig::true_currents(double time) const {
  // Three slow waves a coil, as a magnet is pulled about: weight, lowest and highest frequency.
  struct Wave {
    double weight, low, high;
  };
  constexpr std::array<Wave, 3> kWaves = {{{0.5, 0.03, 0.2}, {0.3, 0.15, 0.5}, {0.2, 0.4, 1.0}}};
  Eigen::VectorXd currents = Eigen::VectorXd::Zero(num_coils());
  for (Eigen::Index coil = 0; coil < currents.size(); ++coil) {
    const CounterRandom random(
        scenario_.seed, stream_id(RandomStream::kCurrentWaves, static_cast<std::uint64_t>(coil)));
    std::uint64_t n = 0;
    for (const Wave& wave : kWaves) {
      const double frequency = wave.low + (wave.high - wave.low) * random.uniform(n++);
      currents[coil] += scenario_.magnetics.current_amplitude * wave.weight *
                        std::sin(2 * std::numbers::pi * (frequency * time + random.uniform(n++)));
    }
  }
  return currents;
}

Eigen::VectorXd MagneticRig::measured_currents(std::int64_t index, double time) const {
  Eigen::VectorXd currents = true_currents(time);
  const CounterRandom random(
      scenario_.seed, stream_id(RandomStream::kCurrentNoise, static_cast<std::uint64_t>(index)));
  for (Eigen::Index coil = 0; coil < currents.size(); ++coil) {
    currents[coil] +=
        scenario_.rig.coils.current_noise * random.normal(static_cast<std::uint64_t>(coil));
  }
  return currents;
}

Eigen::Vector3d MagneticRig::foreign_field(const Eigen::Vector3d& point, double time) const {
  Eigen::Vector3d field = Eigen::Vector3d::Zero();
  for (const FaultConfiguration& fault : scenario_.faults) {
    if (fault.kind != FaultKind::kForeignField || !fault.active(time)) continue;
    field += fault.envelope(time) * dipole_field(point - fault.position, fault.moment);
  }
  return field;
}

HallReading MagneticRig::read(std::int64_t index, double time,
                              const std::optional<SE3>& rig_T_magnet) {
  const HallArrayConfiguration& array = scenario_.rig.hall_array;
  const MagneticsConfiguration& magnetics = scenario_.magnetics;
  const CounterRandom random(
      scenario_.seed, stream_id(RandomStream::kHallNoise, static_cast<std::uint64_t>(index)));
  Eigen::Vector3d lowered = Eigen::Vector3d::Zero();
  for (const FaultConfiguration& fault : scenario_.faults) {
    if (fault.kind == FaultKind::kMagnetFar) {
      lowered.z() -= fault.envelope(time) * fault.strength;
    }
  }
  HallReading reading;
  reading.field = true_matrix_ * true_currents(time);
  reading.status.assign(sensors_.size(), 0);
  std::uint64_t drawn = 0;
  for (std::size_t i = 0; i < sensors_.size(); ++i) {
    const HallSensorConfiguration& sensor = sensors_[i];
    Eigen::Vector3d field = magnetics.background + foreign_field(sensor.position, time);
    if (rig_T_magnet) {
      field += magnet_.field(sensor.position - rig_T_magnet->translation - lowered,
                             rig_T_magnet->rotation * Eigen::Vector3d::UnitZ());
    }
    const Eigen::Index first = static_cast<Eigen::Index>(i) * array.num_axes;
    const Eigen::VectorXd measured = sensor.response * field;
    for (Eigen::Index axis = 0; axis < array.num_axes; ++axis) {
      double& value = reading.field[first + axis];
      value += measured[axis] + sensor.offset[static_cast<std::size_t>(axis)] +
               array.noise * random.normal(drawn++);
      if (magnetics.quantisation > 0) {
        value = magnetics.quantisation * std::round(value / magnetics.quantisation);
      }
    }
    auto channels = reading.field.segment(first, array.num_axes);
    for (const FaultConfiguration& fault : scenario_.faults) {
      if (!fault.active(time) || !lists(fault, i)) continue;
      if (fault.kind == FaultKind::kSaturatedSensor) channels.setConstant(array.saturation);
      if (fault.kind == FaultKind::kStuckSensor || fault.kind == FaultKind::kStaleSensor) {
        channels = last_.segment(first, array.num_axes);
      }
      if (fault.kind == FaultKind::kStaleSensor) reading.status[i] |= kSensorStale;
    }
    if ((channels.array().abs() >= array.saturation).any()) {
      channels = channels.cwiseMax(-array.saturation).cwiseMin(array.saturation);
      reading.status[i] |= kSensorSaturated;
    }
  }
  last_ = reading.field;
  return reading;
}

}  // namespace gastronaut

#include "array_simulation.hpp"

#include <cmath>
#include <numbers>

#include "magnetics/axial_magnet.hpp"
#include "magnetics/dipole.hpp"
#include "numerics/counter_random.hpp"

namespace gastronaut {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;
constexpr int kCoils = 4;

Eigen::MatrixXd coil_matrix(const HallArrayConfiguration& array) {
  const auto sensors = array.resolved_sensors();
  Eigen::MatrixXd matrix(static_cast<Eigen::Index>(sensors.size()) * array.num_axes, kCoils);
  const Eigen::Vector3d moment_per_ampere(0, 0, 3);  // A m^2: 300 turns of 113 mm
  for (int coil = 0; coil < kCoils; ++coil) {
    const Eigen::Vector3d place((coil % 2 - 0.5) * 0.12, (coil / 2 - 0.5) * 0.12, -0.13);
    for (std::size_t s = 0; s < sensors.size(); ++s) {
      matrix.block(static_cast<Eigen::Index>(s) * array.num_axes, coil, array.num_axes, 1) =
          sensors[s].response * dipole_field(sensors[s].position - place, moment_per_ampere);
    }
  }
  return matrix;
}

}  // namespace

RigConfiguration simulated_rig(int num_axes) {
  RigConfiguration rig;
  rig.hall_array.rows = rig.hall_array.cols = num_axes == 3 ? 4 : 8;
  rig.hall_array.pitch = 0.12 / (rig.hall_array.rows - 1);
  rig.hall_array.num_axes = num_axes;
  rig.magnetic_localizer.background_std = 3e-5;  // the simulated background is of that size
  rig.hall_array.sensors = rig.hall_array.resolved_sensors();
  rig.coils.tesla_per_ampere = coil_matrix(rig.hall_array);
  return rig;
}

RigConfiguration with_sensor_errors(const RigConfiguration& rig, const ArrayPriors& priors,
                                    std::uint64_t seed) {
  const CounterRandom random(seed, 0);
  RigConfiguration truth = rig;
  std::uint64_t number = 0;
  truth.magnet.moment += rig.magnet.moment_std * random.normal(number++);
  for (HallSensorConfiguration& sensor : truth.hall_array.sensors) {
    for (Eigen::Index axis = 0; axis < sensor.response.rows(); ++axis) {
      const Eigen::RowVector3d row = sensor.response.row(axis);
      const Eigen::Matrix<double, 3, 2> across = perpendicular_basis(row.transpose().normalized());
      sensor.response.row(axis) += priors.gain_std * random.normal(number++) * row;
      for (Eigen::Index i = 0; i < 2; ++i) {
        sensor.response.row(axis) +=
            priors.alignment_std * random.normal(number++) * across.col(i).transpose();
      }
      sensor.offset[static_cast<std::size_t>(axis)] += priors.offset_std * random.normal(number++);
    }
  }
  truth.coils.tesla_per_ampere = coil_matrix(truth.hall_array);
  return truth;
}

MagnetPose wide_path(double phase) {
  MagnetPose pose;
  pose.position = {0.06 * std::sin(3 * kTurn * phase), 0.06 * std::sin(4 * kTurn * phase + 0.5),
                   0.015 * std::sin(5 * kTurn * phase + 1)};
  pose.axis = Eigen::Vector3d(std::sin(7 * kTurn * phase), std::cos(9 * kTurn * phase + 0.3),
                              std::sin(11 * kTurn * phase + 0.7))
                  .normalized();
  return pose;
}

Eigen::VectorXd independent_currents(double phase) {
  Eigen::VectorXd currents(kCoils);
  for (int coil = 0; coil < kCoils; ++coil) {
    currents(coil) = 2 * std::sin((3 + 2 * coil) * kTurn * phase + coil);
  }
  return currents;
}

std::vector<CalibrationReading> simulate(const RigConfiguration& truth, const SimulatedRun& run) {
  const CounterRandom random(run.seed, 1);
  std::uint64_t number = 0;
  const double ratio = octupole_ratio(truth.magnet.shape());
  std::vector<CalibrationReading> readings;
  for (int i = 0; i < run.readings; ++i) {
    const double phase = static_cast<double>(i) / run.readings;
    CalibrationReading reading;
    reading.utime = i * std::int64_t{10000};
    std::vector<double> values;
    for (const HallSensorConfiguration& sensor : truth.hall_array.sensors) {
      Eigen::Vector3d field = run.background;
      if (run.path) {
        const MagnetPose pose = run.path(phase);
        field += axial_magnet_field(sensor.position - pose.position,
                                    truth.magnet.moment * pose.axis, ratio);
      }
      for (Eigen::Index axis = 0; axis < sensor.response.rows(); ++axis) {
        values.push_back(sensor.response.row(axis).dot(field) +
                         sensor.offset[static_cast<std::size_t>(axis)] +
                         truth.hall_array.noise * random.normal(number++));
      }
    }
    reading.field =
        Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
    reading.usable.assign(values.size(), true);
    reading.currents = run.currents(phase);
    reading.field += truth.coils.tesla_per_ampere * reading.currents;
    for (double& current : reading.currents) {
      current += truth.coils.current_noise * random.normal(number++);
    }
    if (run.known_poses) reading.known_pose = run.path(phase);
    readings.push_back(std::move(reading));
  }
  return readings;
}

}  // namespace gastronaut

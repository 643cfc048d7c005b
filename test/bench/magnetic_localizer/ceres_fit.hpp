// The off-the-shelf way: Ceres with automatic derivatives for position, axis and background of one
// reading, all channels weighed alike. The peer of the localiser's benchmark and of its regression
// tests.
#pragma once

#include <ceres/ceres.h>

#include <vector>

#include "configuration/rig_configuration.hpp"
#include "magnetic_localizer/magnet_state.hpp"
#include "magnetics/axial_magnet.hpp"
#include "magnetics/dipole.hpp"

namespace gastronaut::test {

// One sensor's three readings.
struct SensorResidual {
  const HallSensorConfiguration& sensor;
  Eigen::Vector3d reading;
  double moment, ratio, noise;

  template <class T>
  bool operator()(const T* position, const T* axis, const T* background, T* residual) const {
    const T d[3] = {sensor.position.x() - position[0], sensor.position.y() - position[1],
                    sensor.position.z() - position[2]};
    const T r2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
    const T s = axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2];
    const T r3 = r2 * sqrt(r2);
    const T r5 = r3 * r2;
    const T r7 = r5 * r2;
    const T along_axis = -1.0 / r3 + ratio * (1.5 / r5 - 7.5 * s * s / r7);
    const T along_offset = 3.0 * s / r5 + ratio * (17.5 * s * s * s / r2 - 7.5 * s) / r7;
    T field[3];
    for (int k = 0; k < 3; ++k) {
      field[k] = kMagneticConstantOver4Pi * moment * (along_axis * axis[k] + along_offset * d[k]) +
                 background[k];
    }
    for (int k = 0; k < 3; ++k) {
      residual[k] = (reading[k] - sensor.response(k, 0) * field[0] -
                     sensor.response(k, 1) * field[1] - sensor.response(k, 2) * field[2]) /
                    noise;
    }
    return true;
  }
};

// `field` in tesla with the coils' part and the offsets taken out; `state` is where to start.
// Returns whether there is a solution.
inline bool ceres_fit(const RigConfiguration& rig,
                      const std::vector<HallSensorConfiguration>& sensors,
                      const Eigen::VectorXd& field, magnetics::MagnetState& state) {
  ceres::Problem problem;
  for (std::size_t s = 0; s < sensors.size(); ++s) {
    problem.AddResidualBlock(
        new ceres::AutoDiffCostFunction<SensorResidual, 3, 3, 3, 3>(new SensorResidual{
            sensors[s], field.segment<3>(3 * static_cast<Eigen::Index>(s)), rig.magnet.moment,
            octupole_ratio(rig.magnet.shape()), rig.hall_array.noise}),
        nullptr, state.position.data(), state.axis.data(), state.background.data());
  }
  problem.SetManifold(state.axis.data(), new ceres::SphereManifold<3>());
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary.IsSolutionUsable();
}

}  // namespace gastronaut::test

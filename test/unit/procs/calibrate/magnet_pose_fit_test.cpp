#include "calibrate/magnet_pose_fit.hpp"

#include <gtest/gtest.h>

#include "array_simulation.hpp"
#include "magnetics/axial_magnet.hpp"

namespace gastronaut {
namespace {

// Cramer-Rao bound of the position's covariance, background unknown.
Eigen::Matrix3d position_bound(const RigConfiguration& rig, const MagnetPose& pose) {
  Eigen::Matrix<double, 8, 8> information = Eigen::Matrix<double, 8, 8>::Zero();
  for (const HallSensorConfiguration& sensor : rig.hall_array.sensors) {
    const AxialMagnetDerivatives magnet =
        axial_magnet_derivatives(sensor.position - pose.position, rig.magnet.moment * pose.axis,
                                 octupole_ratio(rig.magnet.shape()));
    Eigen::Matrix<double, 3, 8> rows;
    rows << -magnet.by_offset,
        rig.magnet.moment * magnet.by_moment * perpendicular_basis(pose.axis),
        Eigen::Matrix3d::Identity();
    information += rows.transpose() * rows / std::pow(rig.hall_array.noise, 2);
  }
  return information.inverse().topLeftCorner<3, 3>();
}

TEST(MagnetPoseFit, FindsTheMagnetFromNothingAsWellAsTheNoiseAllows) {
  RigConfiguration rig = simulated_rig(3);
  rig.coils.current_noise = 0;
  rig.hall_array.noise /= 10;  // small errors, for which the bound is exact
  rig.hall_array.offset_std = 0;
  SimulatedRun run{wide_path, independent_currents};
  run.readings = 100;
  const auto readings = simulate(rig, run);
  const MagnetPoseFitter fitter(rig);
  double squares = 0;
  for (int i = 0; i < run.readings; ++i) {
    const auto fit = fitter.fit(readings[static_cast<std::size_t>(i)], std::nullopt);
    ASSERT_TRUE(fit) << i;
    const MagnetPose truth = wide_path(static_cast<double>(i) / run.readings);
    const Eigen::Vector3d error = fit->pose.position - truth.position;
    squares += error.dot(position_bound(rig, truth).ldlt().solve(error));
  }
  constexpr double kFourSigmas = 0.98;  // 4 sqrt(2 * 3 / 100)
  EXPECT_NEAR(squares / run.readings, 3, kFourSigmas);
}

TEST(MagnetPoseFit, HasNothingToSayWithTooFewChannels) {
  const RigConfiguration rig = simulated_rig(3);
  SimulatedRun run{wide_path, independent_currents};
  run.readings = 1;
  auto reading = simulate(rig, run).front();
  reading.usable.assign(reading.usable.size(), false);
  EXPECT_FALSE(MagnetPoseFitter(rig).fit(reading, std::nullopt));
}

TEST(MagnetPoseFit, TellsAMagnetsPatternFromScatteredOffsets) {
  const RigConfiguration rig = simulated_rig(3);
  SimulatedRun run{wide_path, [](double) { return Eigen::VectorXd::Zero(4); }};
  run.readings = 1;
  const MagnetPoseFitter fitter(rig);
  constexpr double kMost = 0.9;
  EXPECT_GT(fitter.explained_by_magnet(simulate(rig, run).front().field), kMost);
  run.path = nullptr;
  const RigConfiguration scattered = with_sensor_errors(rig, ArrayPriors{}, 1);
  constexpr double kLittle = 0.6;  // nine unknowns and the best of many places, for 48 values
  EXPECT_LT(fitter.explained_by_magnet(simulate(scattered, run).front().field), kLittle);
}

}  // namespace
}  // namespace gastronaut

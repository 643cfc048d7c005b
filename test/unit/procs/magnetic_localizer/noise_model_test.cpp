#include "magnetic_localizer/noise_model.hpp"

#include <gtest/gtest.h>

#include "unit/procs/magnetic_localizer/simulated_array.hpp"

namespace gastronaut::magnetics {
namespace {

TEST(NoiseModel, CovarianceIsThatOfSensorsWithSuchErrors) {
  // 4000 draws determine a variance within 2.2 %, one sigma; four sigmas of 3 entries.
  constexpr int kDraws = 4000;
  constexpr double kSampling = 0.09;
  RigConfiguration rig;
  rig.hall_array.rows = rig.hall_array.cols = 1;
  rig.hall_array.gain_std = 0.01;
  rig.hall_array.alignment_std = 0.02;
  rig.hall_array.offset_std = 3e-6;
  rig.hall_array.noise = 2e-6;
  const Eigen::Vector3d field(300e-6, -500e-6, 200e-6);
  const auto ideal = rig.hall_array.resolved_sensors();
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (int i = 0; i < kDraws; ++i) {
    const auto real =
        test::with_sensor_errors(rig.hall_array, static_cast<std::uint64_t>(i)).sensors[0];
    test::Draws draws(9, static_cast<std::uint64_t>(i));
    Eigen::Vector3d error = (real.response - ideal[0].response) * field;
    for (int axis = 0; axis < 3; ++axis) {
      error[axis] +=
          real.offset[static_cast<std::size_t>(axis)] + rig.hall_array.noise * draws.normal();
    }
    scatter += error * error.transpose() / kDraws;
  }
  const SensorArray array(rig.hall_array);
  CleanReading reading;
  reading.value = field;
  reading.variance = Eigen::Vector3d::Zero();
  reading.usable = Eigen::Vector3d::Ones();
  SensorMatrices covariance;
  NoiseModel(array, rig.hall_array).covariance(reading, field, covariance);
  Eigen::Matrix3d model;
  model << covariance[0][0], covariance[1][0], covariance[2][0],  //
      covariance[1][0], covariance[3][0], covariance[4][0],       //
      covariance[2][0], covariance[4][0], covariance[5][0];
  EXPECT_LT((model - scatter).norm(), kSampling * scatter.norm()) << model << "\n\n" << scatter;
}

TEST(FieldInformation, SaysTheSameAsTheReadingsItself) {
  constexpr double kRounding = 1e-9;
  RigConfiguration rig;
  rig.hall_array.sensors = test::with_sensor_errors(rig.hall_array, 3).sensors;
  const SensorArray array(rig.hall_array);
  test::Draws draws(4, 0);
  const MagnetState state = test::random_state(rig, draws, 0.05, 0.05, 0.1);
  const HallReading raw = test::simulate_reading(rig.hall_array, rig.magnet, state, &draws);
  CleanReading reading;
  ReadingCleaner(rig).clean(raw, std::nullopt, reading);
  reading.usable[7] = 0;  // one axis of sensor 7
  const Eigen::VectorXd field = measured_field(array, reading);
  SensorMatrices v;
  NoiseModel(array, rig.hall_array).covariance(reading, field, v);
  FieldInformation information(array.num_sensors);
  inform(array, reading, v, information);
  Eigen::VectorXd misfits;
  Eigen::VectorXd somewhere = 1.01 * field;
  sensor_misfits(information, somewhere, misfits);
  for (Eigen::Index s = 0; s < array.num_sensors; ++s) {
    const HallSensorConfiguration& sensor = rig.hall_array.sensors[static_cast<std::size_t>(s)];
    const Eigen::Vector3d b(somewhere[s], somewhere[64 + s], somewhere[128 + s]);
    const Eigen::Vector3d value(reading.value[s], reading.value[64 + s], reading.value[128 + s]);
    Eigen::Matrix3d covariance;
    covariance << v[0][s], v[1][s], v[2][s], v[1][s], v[3][s], v[4][s], v[2][s], v[4][s], v[5][s];
    Eigen::Vector3d residual = value - sensor.response * b;
    if (s == 7) residual[0] = 0;
    const double expected = residual.dot(covariance.inverse() * residual);
    EXPECT_NEAR(misfits[s], expected, kRounding * information.scalar[s]) << "sensor " << s;
  }
}

}  // namespace
}  // namespace gastronaut::magnetics

#include "magnetic_localizer/second_difference.hpp"

#include <gtest/gtest.h>

#include "unit/procs/magnetic_localizer/simulated_array.hpp"

namespace gastronaut::magnetics {
namespace {

struct Scene {
  explicit Scene(RigConfiguration configuration) : rig(std::move(configuration)) {}

  double misfit(const MagnetState& state, const HallReading& raw) {
    CleanReading reading;
    ReadingCleaner(rig).clean(raw, std::nullopt, reading);
    SensorMatrices covariance;
    NoiseModel(array, rig.hall_array)
        .covariance(reading, measured_field(array, reading), covariance);
    FieldInformation information(array.num_sensors);
    inform(array, reading, covariance, information);
    differences.set_reading(reading, covariance, information);
    NormalEquations equations;
    differences.evaluate(state, equations);
    return equations.misfit;
  }

  RigConfiguration rig;
  SensorArray array{rig.hall_array};
  MagnetModel model{array, octupole_ratio(rig.magnet.shape())};
  SecondDifference differences{array, model, rig.hall_array, rig.magnetic_localizer.background_std};
};

MagnetState some_state(const RigConfiguration& rig) {
  test::Draws draws(1, 0);
  return test::random_state(rig, draws, 0.03, 0.04, 0.06);
}

TEST(SecondDifference, UniformBackgroundAndGradientsCancel) {
  constexpr double kNothing = 1e-9;  // squared standard deviations: rounding
  Scene scene(test::exact_rig());
  const MagnetState state = some_state(scene.rig);
  HallReading reading =
      test::simulate_reading(scene.rig.hall_array, scene.rig.magnet, state, nullptr);
  const auto sensors = scene.rig.hall_array.resolved_sensors();
  Eigen::Matrix3d gradient;
  gradient << 1e-4, 2e-4, 3e-4, 2e-4, -3e-4, 1e-4, 3e-4, 1e-4, 2e-4;  // tesla per metre
  for (std::size_t s = 0; s < sensors.size(); ++s) {
    reading.field.segment<3>(static_cast<Eigen::Index>(3 * s)) +=
        Eigen::Vector3d(50e-6, -20e-6, 10e-6) + gradient * sensors[s].position;
  }
  EXPECT_LT(scene.misfit(state, reading), kNothing);
}

TEST(SecondDifference, NoiseOfNeighbouringStencilsIsAccountedFor) {
  // The misfit at the truth is chi-square with as many degrees of freedom as there are stencils.
  constexpr int kReadings = 100;
  constexpr double kFourSigmas = 4 * 0.0136;  // sqrt(2 / (100 * 108))
  Scene scene(test::exact_rig());
  const MagnetState state = some_state(scene.rig);
  double sum = 0;
  for (int i = 0; i < kReadings; ++i) {
    test::Draws draws(2, static_cast<std::uint64_t>(i));
    sum += scene.misfit(
        state, test::simulate_reading(scene.rig.hall_array, scene.rig.magnet, state, &draws));
  }
  EXPECT_EQ(scene.differences.num_observations(), 3 * 6 * 6);
  EXPECT_NEAR(sum / kReadings / scene.differences.num_observations(), 1, kFourSigmas);
}

TEST(SecondDifference, AFaultySensorTakesItsStencilsAlong) {
  Scene scene(test::exact_rig());
  const MagnetState state = some_state(scene.rig);
  HallReading reading =
      test::simulate_reading(scene.rig.hall_array, scene.rig.magnet, state, nullptr);
  reading.status[3 * 8 + 4] = 1;  // inside: centre of one stencil, neighbour of four
  scene.misfit(state, reading);
  EXPECT_EQ(scene.differences.num_observations(), 3 * (36 - 5));
}

TEST(SecondDifference, MonoAxialArraysGiveOneDifferenceAStencil) {
  RigConfiguration rig = test::exact_rig();
  rig.hall_array.num_axes = 1;
  Scene scene(rig);
  constexpr double kNothing = 1e-9;
  const MagnetState state = some_state(rig);
  EXPECT_LT(scene.misfit(state, test::simulate_reading(rig.hall_array, rig.magnet, state, nullptr)),
            kNothing);
  EXPECT_EQ(scene.differences.num_observations(), 36);
}

TEST(SecondDifference, ArraysThatAreNoGridAreRefused) {
  RigConfiguration small = test::exact_rig();
  small.hall_array.rows = 2;
  EXPECT_THROW(Scene{small}, ConfigurationError);
  RigConfiguration crooked = test::exact_rig();
  crooked.hall_array.sensors = crooked.hall_array.resolved_sensors();
  crooked.hall_array.sensors[20].position.y() += 0.002;
  EXPECT_THROW(Scene{crooked}, ConfigurationError);
}

}  // namespace
}  // namespace gastronaut::magnetics

// A warm fix of 64 x 3 channels, beside Ceres with automatic derivatives on the same problem
// (position, axis, background; white noise; ring magnet), same readings, same run.
#include <benchmark/benchmark.h>

#include <vector>

#include "bench/magnetic_localizer/ceres_fit.hpp"
#include "magnetic_localizer/magnetic_localizer.hpp"
#include "unit/procs/magnetic_localizer/simulated_array.hpp"

namespace gastronaut::magnetics {
namespace {

// A capsule that moves 0.2 mm and turns half a degree between readings, and back again.
struct Track {
  RigConfiguration rig;
  std::vector<MagnetState> states;
  std::vector<HallReading> readings;

  explicit Track(const RigConfiguration& configuration) : rig(configuration) {
    test::Draws draws(1, 0);
    MagnetState state;
    state.position = {0.01, -0.01, 0.02};
    state.axis = Eigen::Vector3d(0.5, -0.6, 0.4).normalized();
    state.moment = rig.magnet.moment;
    state.background = {18e-6, -6e-6, -42e-6};
    constexpr int kHalf = 50;
    for (int i = 0; i < 2 * kHalf; ++i) {
      const double direction = i < kHalf ? 1 : -1;
      state.position += direction * Eigen::Vector3d(0.2e-3, 0, 0.05e-3);
      state.axis = so3_exp(direction * 0.009 * Eigen::Vector3d::UnitY()) * state.axis;
      states.push_back(state);
      readings.push_back(test::simulate_reading(rig.hall_array, rig.magnet, state, &draws));
    }
  }
};

void warm_fix(benchmark::State& timer, const RigConfiguration& rig) {
  const Track track(rig);
  MagneticLocalizer localizer(rig);
  localizer.localize(track.readings.back(), std::nullopt);
  std::size_t i = 0;
  for (auto _ : timer) {
    const MagneticFix fix = localizer.localize(track.readings[i], std::nullopt);
    if (fix.status != FixStatus::kOk) timer.SkipWithError("no fix");
    benchmark::DoNotOptimize(fix);
    i = (i + 1) % track.readings.size();
  }
}

void full_field_warm(benchmark::State& timer) { warm_fix(timer, test::exact_rig()); }

void full_field_warm_with_sensor_errors(benchmark::State& timer) {
  warm_fix(timer, RigConfiguration());
}

void second_difference_warm(benchmark::State& timer) {
  RigConfiguration rig = test::exact_rig();
  rig.magnetic_localizer.estimator = MagneticEstimator::kSecondDifference;
  warm_fix(timer, rig);
}

void global_start(benchmark::State& timer) {
  const Track track(test::exact_rig());
  std::size_t i = 0;
  for (auto _ : timer) {
    timer.PauseTiming();
    MagneticLocalizer localizer(track.rig);
    timer.ResumeTiming();
    benchmark::DoNotOptimize(localizer.localize(track.readings[i], std::nullopt));
    i = (i + 1) % track.readings.size();
  }
}

void ceres_autodiff_warm(benchmark::State& timer) {
  const Track track(test::exact_rig());
  const auto sensors = track.rig.hall_array.resolved_sensors();
  MagnetState state = track.states.back();
  std::size_t i = 0;
  for (auto _ : timer) {
    if (!test::ceres_fit(track.rig, sensors, track.readings[i].field, state)) {
      timer.SkipWithError("no fix");
    }
    benchmark::DoNotOptimize(state);
    i = (i + 1) % track.readings.size();
  }
}

BENCHMARK(full_field_warm)->Unit(benchmark::kMicrosecond);
BENCHMARK(full_field_warm_with_sensor_errors)->Unit(benchmark::kMicrosecond);
BENCHMARK(second_difference_warm)->Unit(benchmark::kMicrosecond);
BENCHMARK(global_start)->Unit(benchmark::kMicrosecond);
BENCHMARK(ceres_autodiff_warm)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace gastronaut::magnetics

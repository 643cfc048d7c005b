// One measurement through the filter, all sensors well, and while nothing is decided yet (all
// hypotheses about the roll alive). The argument is the number of particles; target: 0.5 ms at
// 1000.
#include <benchmark/benchmark.h>

#include <cmath>

#include "sensor_fusion/switching_filter.hpp"

namespace gastronaut::fusion {
namespace {

constexpr std::int64_t kMagneticInterval = 10'000;  // microseconds
constexpr int kMagneticPerVisual = 5;

const SE3 kCameraTMagnet{Eigen::Quaterniond(Eigen::AngleAxisd(0.07, Eigen::Vector3d::UnitX())),
                         {8e-4, -5e-4, -9e-3}};

SE3 camera_at(std::int64_t utime, bool moves) {
  const double t = moves ? static_cast<double>(utime) * 1e-6 : 0;
  return {so3_exp({0.5 * std::sin(0.7 * t), 0.4 * std::sin(0.9 * t), 0.3 * std::sin(0.5 * t)}),
          {0.03 * std::sin(0.4 * t), 0.03 * std::cos(0.3 * t), 0.01 * std::sin(0.6 * t)}};
}

MagneticMeasurement magnetic_at(std::int64_t utime, bool moves) {
  const SE3 rig_T_magnet = camera_at(utime, moves) * kCameraTMagnet;
  MagneticMeasurement measurement;
  measurement.utime = utime;
  measurement.is_usable = true;
  measurement.fix.position = rig_T_magnet.translation;
  measurement.fix.axis = rig_T_magnet.rotation * Eigen::Vector3d::UnitZ();
  measurement.fix.covariance.diagonal() << 1e-7, 1e-7, 1e-7, 1e-4, 1e-4;
  return measurement;
}

VisualMeasurement visual_at(std::int64_t utime, bool moves) {
  VisualMeasurement measurement;
  measurement.utime = utime;
  measurement.is_usable = true;
  measurement.map_T_camera = camera_at(utime, moves);
  measurement.covariance = 1e-8 * Matrix6d::Identity();
  return measurement;
}

SwitchingFilter filter_with(std::int64_t particles) {
  FilterOptions options;
  options.particles = static_cast<std::size_t>(particles);
  options.camera_T_magnet = kCameraTMagnet;
  return SwitchingFilter(options);
}

void run(benchmark::State& state, bool moves, bool with_vision) {
  SwitchingFilter filter = filter_with(state.range(0));
  std::int64_t utime = 1'000'000;
  constexpr std::int64_t kWarmUp = 5'000'000;
  const auto step = [&] {
    utime += kMagneticInterval;
    benchmark::DoNotOptimize(filter.update(magnetic_at(utime, moves)));
    if (with_vision && utime / kMagneticInterval % kMagneticPerVisual == 0) {
      benchmark::DoNotOptimize(filter.update(visual_at(utime, moves)));
    }
  };
  while (utime < kWarmUp) step();
  std::int64_t updates = 0;
  for (auto _ : state) {
    step();
    ++updates;
  }
  state.counters["beliefs"] = static_cast<double>(filter.num_beliefs());
  state.SetItemsProcessed(updates);
}

void BM_FusionUpdate(benchmark::State& state) { run(state, true, true); }
void BM_FusionUpdateWithOpenRoll(benchmark::State& state) { run(state, false, false); }

BENCHMARK(BM_FusionUpdate)->Arg(500)->Arg(1000)->Arg(5000)->Unit(benchmark::kMicrosecond);
BENCHMARK(BM_FusionUpdateWithOpenRoll)->Arg(1000)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace gastronaut::fusion

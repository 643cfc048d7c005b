// Predicting a view of the map and fusing a frame into it, 320 x 240, two threads, for maps of 0.1
// to 2 million surfels of which the view always sees the same 100 000: targets.md allows the
// largest 1.3 times the smallest.
#include <benchmark/benchmark.h>

#include <cmath>
#include <memory>

#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"
#include "visual_slam/surfel_map.hpp"

namespace gastronaut::slam {
namespace {

const PinholeGrid kGrid = {320, 240, 180, 180, 159.5, 119.5};
constexpr double kWall = 0.03;         // metres from the camera to a wall all round
constexpr double kNoise = 0.005;       // of depth
constexpr double kPartDistance = 0.1;  // metres between the parts of the map, all but one behind
constexpr int kPart = 100'000;         // surfels
constexpr std::int64_t kFrameTime = 33'333;

double wall_depth(double u, double v) {
  return kWall / std::hypot((u - kGrid.cx) / kGrid.fx, (v - kGrid.cy) / kGrid.fy, 1);
}

SurfelArrays stable_surfels(int count) {
  const CounterRandom random(1, 0);
  SurfelArrays surfels;
  surfels.resize(static_cast<std::size_t>(count));
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    const std::size_t part = k / kPart;
    const double u = random.uniform(2 * (k % kPart)) * (kGrid.width - 1);
    const double v = random.uniform(2 * (k % kPart) + 1) * (kGrid.height - 1);
    const double depth = wall_depth(u, v);
    const double x = depth * (u - kGrid.cx) / kGrid.fx;
    const double y = depth * (v - kGrid.cy) / kGrid.fy;
    surfels.x[k] = static_cast<float>(x);
    surfels.y[k] = static_cast<float>(y);
    surfels.z[k] = static_cast<float>(depth - kPartDistance * static_cast<double>(part));
    surfels.nx[k] = static_cast<float>(-x / kWall);
    surfels.ny[k] = static_cast<float>(-y / kWall);
    surfels.nz[k] = static_cast<float>(-depth / kWall);
    surfels.albedo[k] = 0.5F;
    surfels.confidence[k] = 20;
    surfels.radius[k] = static_cast<float>(std::sqrt(2) * depth / kGrid.fx);
  }
  return surfels;
}

Frame noisy_frame(std::int64_t utime) {
  const CounterRandom random(2, static_cast<std::uint64_t>(utime));
  Frame frame;
  frame.utime = utime;
  frame.grid = kGrid;
  frame.relative_std = kNoise;
  frame.depth = Plane<float>(kGrid.width, kGrid.height);
  frame.albedo = Plane<float>(kGrid.width, kGrid.height, 0.5F);
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      const auto pixel = static_cast<std::uint64_t>(v * kGrid.width + u);
      frame.depth.at(u, v) =
          static_cast<float>(wall_depth(u, v) * (1 + kNoise * random.normal(pixel)));
    }
  }
  return frame;
}

void predict(benchmark::State& state) {
  set_thread_count(2);
  const SurfelMap map(SurfelMapOptions{}, stable_surfels(static_cast<int>(state.range(0))));
  ModelView view;
  for (auto _ : state) map.predict(SE3{}, kGrid, 0, MapPart::kActive, view);
  state.counters["surfels"] = map.size();
}

void fuse(benchmark::State& state) {
  set_thread_count(2);
  SurfelMap map(SurfelMapOptions{}, stable_surfels(static_cast<int>(state.range(0))));
  ModelView view;
  Frame frame = noisy_frame(0);
  FuseReport report;
  for (auto _ : state) {
    state.PauseTiming();
    frame.utime += kFrameTime;
    map.predict(SE3{}, kGrid, frame.utime, MapPart::kAll, view);
    state.ResumeTiming();
    report = map.fuse(frame, view);
  }
  state.counters["surfels"] = map.size();
  state.counters["associated"] = report.associated;
}

BENCHMARK(predict)
    ->Arg(kPart)
    ->Arg(500'000)
    ->Arg(1'000'000)
    ->Arg(2'000'000)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();
BENCHMARK(fuse)
    ->Arg(kPart)
    ->Arg(500'000)
    ->Arg(1'000'000)
    ->Arg(2'000'000)
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

}  // namespace
}  // namespace gastronaut::slam

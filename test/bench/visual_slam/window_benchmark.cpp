// Adding a keyframe to a full window and refining it, 320 x 240, one thread: off the frame's
// critical path, but it shares two cores with it.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "numerics/parallel.hpp"
#include "visual_slam/keyframe_window.hpp"

namespace gastronaut::slam {
namespace {

const PinholeGrid kGrid = {320, 240, 166.4, 166.4, 159.5, 119.5};
constexpr double kWall = 0.03;        // metres
constexpr double kStep = 0.002;       // metres, from keyframe to keyframe
constexpr double kDepthError = 0.03;  // amplitude, fraction of depth
constexpr double kTracking = 0.0002;  // metres that each pose is off
constexpr int kPath = 12;             // keyframes

double vessels(double x, double y) {
  return 0.5 + 0.08 * std::sin(900 * x + 300 * y) * std::cos(700 * y - 200 * x) +
         0.06 * std::sin(1500 * x - 1900 * y + 1) + 0.05 * std::cos(2100 * x + 1100 * y);
}

SE3 pose(int keyframe) {
  return {Eigen::Quaterniond::Identity(), {kStep * keyframe, 0.3 * kStep * keyframe, 0}};
}

Frame frame(int keyframe) {
  Frame result;
  result.utime = keyframe;
  result.grid = kGrid;
  result.relative_std = kDepthError;
  result.depth = Plane<float>(kGrid.width, kGrid.height);
  result.albedo = Plane<float>(kGrid.width, kGrid.height);
  const Eigen::Vector3d at = pose(keyframe).translation;
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      const double error = kDepthError * std::sin(0.02 * u + keyframe) * std::cos(0.03 * v);
      result.depth.at(u, v) = static_cast<float>(kWall * (1 + error));
      result.albedo.at(u, v) = static_cast<float>(vessels(
          at.x() + kWall * (u - kGrid.cx) / kGrid.fx, at.y() + kWall * (v - kGrid.cy) / kGrid.fy));
    }
  }
  return result;
}

void add_and_refine(benchmark::State& state) {
  set_thread_count(1);
  KeyframeWindowOptions options;
  options.keyframes = static_cast<int>(state.range(0));
  std::vector<Frame> frames;
  for (int k = 0; k < kPath; ++k) frames.push_back(frame(k));
  KeyframeWindow window(kGrid, options);
  SE3 newest;
  int number = 0;
  const auto add = [&] {
    // Up and down the path; as tracking would, from where the keyframe before came to be.
    const auto turn = [](int k) {
      return std::min(k % (2 * kPath), 2 * kPath - 1 - k % (2 * kPath));
    };
    const SE3 moved = pose(turn(std::max(0, number - 1))).inverse() * pose(turn(number));
    SE3 start = newest * moved;
    start.translation.x() += number > 0 ? kTracking : 0;
    window.add(frames[static_cast<std::size_t>(turn(number))], start);
    newest = window.refine().back().map_T_camera;
    ++number;
  };
  for (int k = 0; k < options.keyframes; ++k) add();
  for (auto _ : state) add();
  set_thread_count(0);
}
BENCHMARK(add_and_refine)->Arg(5)->Arg(7)->Arg(10)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace gastronaut::slam

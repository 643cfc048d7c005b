// Tracking a frame, beside OpenCV's RgbdICPOdometry on the same pictures; making a frame; saving
// the map. Two threads.
#include <benchmark/benchmark.h>

#include <cmath>
#include <filesystem>
#include <string>

#include "bench/visual_slam/opencv_odometry.hpp"
#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"
#include "unit/procs/visual_slam/surfel_scene.hpp"
#include "visual_slam/frame_assembly.hpp"
#include "visual_slam/frame_tracker.hpp"
#include "visual_slam/surfel_file.hpp"
#include "visual_slam/surfel_map.hpp"

namespace gastronaut::slam {
namespace {

constexpr int kThreads = 2;
constexpr double kMillimetre = 1e-3;
constexpr double kDepthNoise = 0.002;  // of depth, as a good depth sensor's
constexpr double kAlbedoNoise = 0.005;

// A capsule's camera at the width of the benchmark's argument.
PinholeGrid grid_of(const benchmark::State& state) {
  const PinholeGrid finest{640, 480, 332.8, 332.8, 321.8, 237.8};
  return finest.coarser(finest.width / static_cast<int>(state.range(0)));
}

// A cavity of 35 mm, seen from 5 mm off its middle so that it does not look alike on all sides.
const Eigen::Vector3d kCentre(0.005, 0, -0.003);
constexpr double kRadius = 0.035;
const SE3 kMotion = pose({0.5e-3, -0.4e-3, 0.5e-3}, {0.01, 0.012, -0.008});

// Waves of 3 to 12 mm, like folds and vessels.
double texture(const Eigen::Vector3d& p) {
  return 0.5 + 0.08 * std::sin(900 * p.x() + 300 * p.y()) * std::cos(700 * p.y() - 200 * p.z()) +
         0.06 * std::sin(500 * p.x() - 1100 * p.y() + 1) +
         0.05 * std::sin(1900 * p.x() + 400 * p.z()) * std::sin(1700 * p.y());
}

ModelView view_of_cavity(const SE3& map_T_camera, const PinholeGrid& grid) {
  const Surface wall = sphere(kCentre, kRadius);
  const Plane<float> empty(grid.width, grid.height);
  ModelView view{map_T_camera, grid, empty, empty, empty, empty, empty, empty, {}};
  view.surfel = Plane<std::int32_t>(grid.width, grid.height);
  for (int v = 0; v < grid.height; ++v) {
    for (int u = 0; u < grid.width; ++u) {
      const Eigen::Vector3d ray((u - grid.cx) / grid.fx, (v - grid.cy) / grid.fy, 1);
      const Eigen::Vector3d way = map_T_camera.rotation * ray;
      const double depth = wall(map_T_camera.translation, way);
      const Eigen::Vector3d point = map_T_camera.translation + depth * way;
      const Eigen::Vector3d normal = map_T_camera.rotation.inverse() * (kCentre - point) / kRadius;
      view.depth.at(u, v) = static_cast<float>(depth);
      view.normal_x.at(u, v) = static_cast<float>(normal.x());
      view.normal_y.at(u, v) = static_cast<float>(normal.y());
      view.normal_z.at(u, v) = static_cast<float>(normal.z());
      view.albedo.at(u, v) = static_cast<float>(texture(point));
    }
  }
  return view;
}

Frame frame_of_cavity(const SE3& map_T_camera, const PinholeGrid& grid, std::uint64_t seed) {
  const ModelView view = view_of_cavity(map_T_camera, grid);
  Frame frame{0, grid, view.depth, view.albedo, kDepthNoise};
  const CounterRandom random(seed, 0);
  for (std::size_t i = 0; i < frame.depth.size(); ++i) {
    const auto [a, b] = random.normal_pair(i);
    frame.depth.values[i] *= static_cast<float>(1 + kDepthNoise * a);
    frame.albedo.values[i] += static_cast<float>(kAlbedoNoise * b);
  }
  return frame;
}

AlbedoLevels levels_of(const Frame& frame) {
  constexpr float kWhite = 255;
  AlbedoLevels levels{frame.grid, {}};
  for (const float albedo : frame.albedo.values) {
    levels.levels.push_back(static_cast<std::uint8_t>(std::lround(albedo * kWhite)));
  }
  return levels;
}

void report_error(benchmark::State& state, const SE3& estimate) {
  state.counters["error_mm"] = (estimate.translation - kMotion.translation).norm() / kMillimetre;
}

void track(benchmark::State& state) {
  set_thread_count(kThreads);
  const PinholeGrid grid = grid_of(state);
  const ModelView model = view_of_cavity({}, grid);
  const Frame frame = frame_of_cavity(kMotion, grid, 1);
  FrameTracker tracker(grid, {});
  TrackingResult result;
  for (auto _ : state) result = tracker.track(frame, model, {});
  if (result.status == TrackingStatus::kLost) state.SkipWithError(result.cause.c_str());
  report_error(state, result.map_T_camera);
}

// There and back, so that each call finds the frame before prepared, as a sequence would.
void track_with_opencv(benchmark::State& state) {
  set_thread_count(kThreads);
  cv::setNumThreads(kThreads);
  const PinholeGrid grid = grid_of(state);
  const Frame here = frame_of_cavity({}, grid, 2);
  const Frame there = frame_of_cavity(kMotion, grid, 1);
  const auto here_levels = levels_of(here).levels;
  const auto there_levels = levels_of(there).levels;
  OpencvOdometry odometry(grid, SurfelMapOptions{}.working_distance, SurfelMapOptions{}.farthest);
  odometry.track(here.depth, here_levels);
  std::optional<SE3> here_T_there;
  bool is_there = false;
  for (auto _ : state) {
    is_there = !is_there;
    auto motion = is_there ? odometry.track(there.depth, there_levels)
                           : odometry.track(here.depth, here_levels);
    if (is_there) here_T_there = motion;
  }
  if (!here_T_there) return state.SkipWithError("refused");
  report_error(state, *here_T_there);
}

// From pictures of 640 x 480 to a frame of the argument's width.
void assemble(benchmark::State& state) {
  set_thread_count(kThreads);
  const PinholeGrid fine{640, 480, 332.8, 332.8, 321.8, 237.8};
  const Frame frame = frame_of_cavity({}, fine, 1);
  constexpr double kMetresPerCount = 5e-6;
  DepthCounts depth{fine, {}, kMetresPerCount, kDepthNoise};
  for (const float metres : frame.depth.values) {
    depth.counts.push_back(static_cast<std::uint16_t>(std::lround(metres / kMetresPerCount)));
  }
  const AlbedoLevels albedo = levels_of(frame);
  const auto width = static_cast<int>(state.range(0));
  for (auto _ : state) benchmark::DoNotOptimize(assemble_frame(0, depth, albedo, width));
}

void keep_map(benchmark::State& state) {
  SurfelArrays surfels;
  surfels.resize(static_cast<std::size_t>(state.range(0)));
  for (std::size_t id = 0; id < surfels.size(); ++id) {
    surfels.x[id] = static_cast<float>(id);
    surfels.radius[id] = static_cast<float>(kMillimetre);
  }
  const auto path = std::filesystem::temp_directory_path() / "gastronaut_tracker_benchmark.surfels";
  for (auto _ : state) save_map(path.string(), {surfels, {}});
  state.counters["bytes"] = static_cast<double>(std::filesystem::file_size(path));
  std::filesystem::remove(path);
}

BENCHMARK(track)->Arg(320)->Arg(640)->Unit(benchmark::kMillisecond)->UseRealTime();
BENCHMARK(track_with_opencv)->Arg(320)->Arg(640)->Unit(benchmark::kMillisecond)->UseRealTime();
BENCHMARK(assemble)->Arg(320)->Arg(640)->Unit(benchmark::kMillisecond)->UseRealTime();
BENCHMARK(keep_map)->Arg(100'000)->Arg(1'000'000)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
}  // namespace gastronaut::slam

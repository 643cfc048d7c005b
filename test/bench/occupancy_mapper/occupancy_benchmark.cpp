// What a frame's worth of changed surfels costs in 1 mm voxels, beside octomap's insertPointCloud
// of the same points from the same place: a camera of 320 x 240 pixels turns in a stomach-sized
// sphere, each frame has every surfel in view a little elsewhere (0.1 mm), as fusing it does.
#include <benchmark/benchmark.h>
#include <octomap/octomap.h>

#include <cmath>
#include <memory>
#include <numbers>
#include <vector>

#include "numerics/counter_random.hpp"
#include "occupancy_mapper/occupancy_map.hpp"

namespace gastronaut::occupancy {
namespace {

constexpr double kRadius = 0.04;      // metres
constexpr double kSpacing = 0.24e-3;  // of surfels: a pixel at that distance
constexpr double kNoise = 1e-4;       // metres, one sigma of what moves a surfel in a frame
constexpr int kFrames = 60;
constexpr double kTurn = 2 * std::numbers::pi / kFrames;
const PinholeGrid kCamera{320, 240, 166.4, 166.4, 159.5, 119.5};

struct Frame {
  MapChange change;
  octomap::Pointcloud cloud;
  SE3 pose;
};

OccupancyOptions options() {
  OccupancyOptions result;
  result.camera = kCamera;
  return result;
}

std::vector<Eigen::Vector3d> sphere() {
  const int count = static_cast<int>(4 * std::numbers::pi * std::pow(kRadius / kSpacing, 2));
  std::vector<Eigen::Vector3d> result;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (2 * i + 1.0) / count;
    const double angle = i * 2 * std::numbers::pi / std::numbers::phi;
    const double r = std::sqrt(1 - z * z);
    result.emplace_back(kRadius * r * std::cos(angle), kRadius * r * std::sin(angle), kRadius * z);
  }
  return result;
}

bool in_view(const Eigen::Vector3d& point) {
  return point.z() > 0 && std::abs(point.x()) * kCamera.fx < point.z() * kCamera.width / 2 &&
         std::abs(point.y()) * kCamera.fy < point.z() * kCamera.height / 2;
}

const std::vector<Frame>& frames() {
  static const std::vector<Frame> result = [] {
    const std::vector<Eigen::Vector3d> wall = sphere();
    std::vector<Frame> made(kFrames);
    for (int i = 0; i < kFrames; ++i) {
      Frame& frame = made[static_cast<std::size_t>(i)];
      const CounterRandom random(1, static_cast<std::uint64_t>(i));
      const double angle = i * kTurn;
      frame.pose.rotation = Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitY());
      frame.pose.translation =
          0.25 * kRadius * Eigen::Vector3d(std::cos(angle), 0, std::sin(angle));
      for (std::size_t k = 0; k < wall.size(); ++k) {
        if (!in_view(frame.pose.inverse() * wall[k])) continue;
        const Eigen::Vector3d normal = -wall[k].normalized();
        const Eigen::Vector3f position =
            (wall[k] + kNoise * random.normal(k) * normal).cast<float>();
        frame.change.changed.push_back(
            {static_cast<std::int32_t>(k), position, normal.cast<float>(), true});
        frame.cloud.push_back(position.x(), position.y(), position.z());
      }
    }
    return made;
  }();
  return result;
}

octomap::point3d origin(const Frame& frame) {
  const Eigen::Vector3f position = frame.pose.translation.cast<float>();
  return {position.x(), position.y(), position.z()};
}

// The n-th frame goes into the map, tree included.
void update(OccupancyMap& map, std::int64_t n) {
  const Frame& frame = frames()[static_cast<std::size_t>(n % kFrames)];
  map.add_pose(n * 33'333, 0, frame.pose);
  map.apply(frame.change);
  benchmark::DoNotOptimize(&map.tree());
}

void insert(octomap::OcTree& tree, std::int64_t n, bool levers) {
  const Frame& frame = frames()[static_cast<std::size_t>(n % kFrames)];
  tree.insertPointCloud(frame.cloud, origin(frame), -1, levers, levers);
  if (levers) tree.updateInnerOccupancy();
}

// Before the clock starts: makes the frames.
void prepare(benchmark::State& state) {
  state.counters["surfels"] = static_cast<double>(frames()[0].change.changed.size());
}

void BM_OurFrame(benchmark::State& state) {
  prepare(state);
  OccupancyMap map(options());
  std::int64_t n = 0;
  for (; n < kFrames; ++n) update(map, n);
  for (auto _ : state) update(map, n++);
}

void BM_OctomapInsertPointCloud(benchmark::State& state) {
  prepare(state);
  octomap::OcTree tree(options().resolution);
  std::int64_t n = 0;
  for (; n < kFrames; ++n) insert(tree, n, true);
  for (auto _ : state) insert(tree, n++, state.range(0) != 0);
}

// Nothing known before: every voxel is new.
void BM_OurFirstFrame(benchmark::State& state) {
  prepare(state);
  for (auto _ : state) {
    state.PauseTiming();
    auto map = std::make_unique<OccupancyMap>(options());
    state.ResumeTiming();
    update(*map, 0);
    state.PauseTiming();
    map.reset();
    state.ResumeTiming();
  }
}

void BM_OctomapFirstFrame(benchmark::State& state) {
  prepare(state);
  for (auto _ : state) {
    state.PauseTiming();
    auto tree = std::make_unique<octomap::OcTree>(options().resolution);
    state.ResumeTiming();
    insert(*tree, 0, state.range(0) != 0);
    state.PauseTiming();
    tree.reset();
    state.ResumeTiming();
  }
}

BENCHMARK(BM_OurFrame)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_OctomapInsertPointCloud)
    ->ArgName("discretized_and_lazy")
    ->Arg(0)
    ->Arg(1)
    ->Unit(benchmark::kMillisecond);
BENCHMARK(BM_OurFirstFrame)->Unit(benchmark::kMillisecond);
BENCHMARK(BM_OctomapFirstFrame)
    ->ArgName("discretized_and_lazy")
    ->Arg(0)
    ->Arg(1)
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace gastronaut::occupancy

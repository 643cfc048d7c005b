// The stages of targets.md: JPEG decode to vessel map at 640 x 480, shape from shading at
// 320 x 240, and a whole picture; on one thread and on two. Written to GASTRONAUT_BENCH_PICTURE,
// the green channel serves the peer (vessel_peer.py), so that both filter the same picture.
#include <benchmark/benchmark.h>

#include <cmath>
#include <cstdlib>
#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "depth_estimator/depth_estimator.hpp"
#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"
#include "unit/procs/depth_estimator/jpeg_encoder.hpp"
#include "unit/procs/depth_estimator/lit_surface.hpp"

namespace gastronaut::perception {
namespace {

RigConfiguration rig_640() {
  RigConfiguration rig;
  rig.camera.width = 640;
  rig.camera.height = 480;
  rig.camera.distortion = {-0.16, 0.025, 0.0004, -0.0003};
  return rig;
}

// A cavity of 35 mm with vessels, mottling and noise, as the default camera sees it.
std::vector<std::uint8_t> cavity(const RigConfiguration& rig) {
  const CameraConfiguration& camera = rig.camera;
  const Surface wall = sphere({0.005, 0, 0.015}, 0.035);
  const CounterRandom random(1, 0);
  std::vector<std::uint8_t> rgb;
  for (int v = 0; v < camera.height; ++v) {
    for (int u = 0; u < camera.width; ++u) {
      const Eigen::Vector3d ray((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1);
      const double vessel =
          std::exp(-std::pow(std::sin(0.05 * u + 2 * std::sin(0.013 * v)) * 8, 2));
      const double grain = 1 + 0.05 * random.normal(rgb.size());
      for (std::size_t c = 0; c < 3; ++c) {
        const double albedo =
            rig.depth_estimator.albedo[c] * (1 - (c == 0 ? 0.1 : 0.3) * vessel) * grain;
        const double light = camera.led_intensity * albedo * light_on(wall(ray), rig.lights);
        rgb.push_back(static_cast<std::uint8_t>(
            255 * std::pow(std::clamp(light, 0.0, 1.0), 1 / camera.gamma)));
      }
    }
  }
  return rgb;
}

const std::vector<std::uint8_t>& jpeg() {
  static const std::vector<std::uint8_t> bytes = [] {
    const std::vector<std::uint8_t> rgb = cavity(rig_640());
    if (const char* file = std::getenv("GASTRONAUT_BENCH_PICTURE")) {
      cv::Mat green(480, 640, CV_8U);
      for (int i = 0; i < 640 * 480; ++i) green.data[i] = rgb[static_cast<std::size_t>(3 * i + 1)];
      cv::imwrite(file, green);
    }
    return to_jpeg(rgb, 640, 480);
  }();
  return bytes;
}

EncodedPicture picture() { return {640, 480, 0, PixelFormat::kMjpeg, jpeg()}; }

void BM_DecodeToVessels(benchmark::State& state) {
  set_thread_count(static_cast<int>(state.range(0)));
  FrontEnd front_end(rig_640().camera);
  VesselFilter filter(640, 480, {});
  LinearPicture light;
  Plane<float> response;
  const EncodedPicture encoded = picture();
  for (auto _ : state) {
    if (front_end.process(encoded, light)) state.SkipWithError("picture refused");
    filter.apply(light.green_level, response);
  }
}

void BM_VesselsAlone(benchmark::State& state) {
  set_thread_count(static_cast<int>(state.range(0)));
  FrontEnd front_end(rig_640().camera);
  VesselFilter filter(640, 480, {});
  LinearPicture light;
  Plane<float> response;
  front_end.process(picture(), light);
  for (auto _ : state) filter.apply(light.green_level, response);
}

void BM_ShapeFromShading320x240(benchmark::State& state) {
  set_thread_count(static_cast<int>(state.range(0)));
  const PinholeGrid grid{320, 240, 166.4, 166.4, 160.8, 116.8};
  const LightsConfiguration lights;
  const DepthEstimatorConfiguration options;
  LitSurface lit = light_surface(grid, lights, sphere({0.005, 0, 0.015}, 0.035), options.data_std);
  const CounterRandom random(1, 0);
  for (std::size_t i = 0; i < lit.shading.log_light.size(); ++i) {
    lit.shading.log_light.values[i] += static_cast<float>(options.data_std * random.normal(i));
  }
  ShapeFromShading solver(grid, NearLight(CameraConfiguration(), lights), options);
  for (auto _ : state) {
    benchmark::DoNotOptimize(solver.solve(lit.shading));
    solver.remember();
  }
}

void BM_WholePicture(benchmark::State& state) {
  set_thread_count(static_cast<int>(state.range(0)));
  DepthEstimator estimator(rig_640());
  const EncodedPicture encoded = picture();
  for (auto _ : state) {
    if (estimator.estimate(encoded, 1.0).failure) state.SkipWithError("picture refused");
  }
}

#define GASTRONAUT_BENCHMARK(name) \
  BENCHMARK(name)->ArgName("threads")->Arg(1)->Arg(2)->UseRealTime()->Unit(benchmark::kMillisecond)
GASTRONAUT_BENCHMARK(BM_DecodeToVessels);
GASTRONAUT_BENCHMARK(BM_VesselsAlone);
GASTRONAUT_BENCHMARK(BM_ShapeFromShading320x240);
GASTRONAUT_BENCHMARK(BM_WholePicture);

}  // namespace
}  // namespace gastronaut::perception

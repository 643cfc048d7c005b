#include "virtual_rig/camera_simulator.hpp"

#include <turbojpeg.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <stdexcept>

#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"
#include "virtual_rig/random_streams.hpp"

namespace gastronaut {
namespace {

constexpr std::size_t kRowsPerChunk = 8;
// A moving picture is the mean of several, this far apart at most, and not too many of them.
constexpr double kPixelsBetweenShots = 1.5;
constexpr int kMostShots = 10;
constexpr double kLowestGain = 0.1;
constexpr double kHighestGain = 20;
constexpr double kExposureSpeed = 0.5;  // part of the error that one frame corrects
// Linear light of gastric fluid at gain 1: turbid, yellowish.
const Eigen::Vector3f kFluidGlow(0.34F, 0.31F, 0.17F);
const Eigen::Vector3f kOccluder(0.55F, 0.09F, 0.06F);  // tissue on the lens, lit from behind

float* pixel(std::vector<float>& picture, int width, int row, int col) {
  return picture.data() + 3 * (static_cast<std::ptrdiff_t>(row) * width + col);
}

// Standard normal quantiles: a lookup costs far less than logarithms and sines for each pixel.
class NormalTable {
 public:
  NormalTable() : quantiles_(kSize) {
    // Inverse of the distribution function by Newton's method, from the middle outwards.
    double x = 0;
    for (std::size_t i = kSize / 2; i < kSize; ++i) {
      const double p = (static_cast<double>(i) + 0.5) / kSize;
      constexpr int kIterations = 8;
      for (int k = 0; k < kIterations; ++k) {
        const double density = std::exp(-x * x / 2) / std::sqrt(2 * std::numbers::pi);
        x -= (0.5 * std::erfc(-x / std::numbers::sqrt2) - p) / density;
      }
      quantiles_[i] = static_cast<float>(x);
      quantiles_[kSize - 1 - i] = static_cast<float>(-x);
    }
  }
  float operator()(std::uint32_t bits) const { return quantiles_[bits & (kSize - 1)]; }

 private:
  static constexpr std::size_t kSize = 65536;
  std::vector<float> quantiles_;
};

// 255 L^(1/gamma) for L in 0..1, looked up over sqrt(L) where it is nearly straight.
class GammaTable {
 public:
  explicit GammaTable(double gamma) : levels_(kSteps + 2) {
    for (std::size_t i = 0; i < levels_.size(); ++i) {
      const double root = static_cast<double>(i) / kSteps;
      levels_[i] = static_cast<float>(255 * std::pow(root * root, 1 / gamma));
    }
  }
  std::uint8_t operator()(float light) const {
    const float place = std::sqrt(std::clamp(light, 0.0F, 1.0F)) * kSteps;
    const auto step = static_cast<std::size_t>(place);
    const float level =
        levels_[step] + (place - static_cast<float>(step)) * (levels_[step + 1] - levels_[step]);
    return static_cast<std::uint8_t>(std::min(level + 0.5F, 255.0F));
  }

 private:
  static constexpr std::size_t kSteps = 4096;
  std::vector<float> levels_;
};

}  // namespace

CameraSimulator::CameraSimulator(const VirtualRigScenario& scenario, const Organ& organ,
                                 const Trajectory& trajectory)
    : scenario_(scenario),
      organ_(organ),
      trajectory_(trajectory),
      tissue_(organ.configuration(), organ.rest()),
      renderer_(scenario.rig.camera, scenario.rig.lights, organ.rest(), tissue_, organ.moves()),
      wall_(organ.rest()),
      jpeg_(tjInitCompress()) {
  if (jpeg_ == nullptr) throw std::runtime_error("the JPEG encoder cannot be started");
}

CameraSimulator::~CameraSimulator() { tjDestroy(jpeg_); }

// One frame: move the wall, expose, spoil as the faults say, develop, compress.
CameraFrame CameraSimulator::take(std::int64_t index, double time) {
  const CameraConfiguration& camera = scenario_.rig.camera;
  if (organ_.moves()) {
    organ_.deform(time, wall_);
    renderer_.move_wall(wall_);
  }
  CameraFrame frame;
  frame.gain = gain_;
  std::vector<float> picture =
      renderer_.render(poses_while_open(time), camera.exposure_gain * frame.gain, fluid_at(time));
  for (const FaultConfiguration& fault : scenario_.faults) {
    const double strength = fault.envelope(time) * fault.strength;
    if (strength == 0) continue;
    if (fault.kind == FaultKind::kBlur) blur(picture, strength);
    if (fault.kind == FaultKind::kOcclusion) occlude(picture, time, strength);
  }
  const std::vector<std::uint8_t> developed = develop(picture, index);
  if (camera.auto_exposure) adjust_gain(developed);
  frame.jpeg = compress(developed);

  const std::vector<float> depth = renderer_.depth(trajectory_.pose(time).value());
  frame.depth.resize(depth.size());
  constexpr double kMostCounts = std::numeric_limits<std::uint16_t>::max();
  for (std::size_t i = 0; i < depth.size(); ++i) {
    frame.depth[i] = static_cast<std::uint16_t>(std::min(
        kMostCounts, std::round(static_cast<double>(depth[i]) / camera.metres_per_depth_count)));
  }
  return frame;
}

std::vector<SE3> CameraSimulator::poses_while_open(double time) const {
  const double exposure = scenario_.imaging.exposure;
  const auto pose = [&](double fraction) {
    return trajectory_.pose(time + (fraction - 0.5) * exposure).value();
  };
  const double motion = renderer_.motion_in_pixels(pose(0), pose(1));
  const int shots =
      std::clamp(static_cast<int>(std::ceil(motion / kPixelsBetweenShots)), 1, kMostShots);
  std::vector<SE3> poses;
  poses.reserve(static_cast<std::size_t>(shots));
  for (int i = 0; i < shots; ++i) poses.push_back(pose((i + 0.5) / shots));
  return poses;
}

Fluid CameraSimulator::fluid_at(double time) const {
  Fluid fluid;
  for (const FaultConfiguration& fault : scenario_.faults) {
    if (fault.kind != FaultKind::kTurbid) continue;
    fluid.extinction += static_cast<float>(fault.envelope(time) * fault.strength);
    fluid.glow = kFluidGlow;
  }
  return fluid;
}

void CameraSimulator::blur(std::vector<float>& picture, double sigma) const {
  const int width = scenario_.rig.camera.width;
  const int height = scenario_.rig.camera.height;
  const int reach = static_cast<int>(std::ceil(3 * sigma));
  std::vector<float> kernel;
  float sum = 0;
  for (int i = -reach; i <= reach; ++i) {
    kernel.push_back(static_cast<float>(std::exp(-0.5 * i * i / (sigma * sigma))));
    sum += kernel.back();
  }
  for (float& weight : kernel) weight /= sum;
  // Across, then down; beyond the border the border's own pixels count.
  std::vector<float> source;
  for (const bool across : {true, false}) {
    source = picture;
    parallel_for_chunks(
        static_cast<std::size_t>(height), kRowsPerChunk, [&](std::size_t begin, std::size_t end) {
          for (auto row = static_cast<int>(begin); row < static_cast<int>(end); ++row) {
            for (int col = 0; col < width; ++col) {
              Eigen::Vector3f mean = Eigen::Vector3f::Zero();
              for (int i = -reach; i <= reach; ++i) {
                const int r = across ? row : std::clamp(row + i, 0, height - 1);
                const int c = across ? std::clamp(col + i, 0, width - 1) : col;
                mean += kernel.data()[reach + i] *
                        Eigen::Map<const Eigen::Vector3f>(pixel(source, width, r, c));
              }
              Eigen::Map<Eigen::Vector3f> blurred(pixel(picture, width, row, col));
              blurred = mean;
            }
          }
        });
  }
}

// Tissue against the lens covers the left `fraction` of the picture, with a soft, slowly moving
// edge.
void CameraSimulator::occlude(std::vector<float>& picture, double time, double fraction) const {
  const int width = scenario_.rig.camera.width;
  const int height = scenario_.rig.camera.height;
  const double softness = 0.06 * width;
  for (int row = 0; row < height; ++row) {
    const double wave = 0.05 * std::sin(6.0 * row / height + 1.7 * time);
    const double edge = width * (fraction + wave * std::min(1.0, 4 * (1 - fraction)));
    for (int col = 0; col < width; ++col) {
      const auto covered = static_cast<float>(std::clamp((edge - col) / softness + 0.5, 0.0, 1.0));
      Eigen::Map<Eigen::Vector3f> light(pixel(picture, width, row, col));
      light = (1 - covered) * light + covered * kOccluder;
    }
  }
}

std::vector<std::uint8_t> CameraSimulator::develop(const std::vector<float>& picture,
                                                   std::int64_t index) const {
  static const NormalTable normal;
  const CameraConfiguration& camera = scenario_.rig.camera;
  const GammaTable level(camera.gamma);
  const auto read2 = static_cast<float>(camera.read_noise * camera.read_noise);
  const auto shot2 = static_cast<float>(camera.shot_noise * camera.shot_noise);
  const CounterRandom random(
      scenario_.seed, stream_id(RandomStream::kImageNoise, static_cast<std::uint64_t>(index)));
  std::vector<std::uint8_t> developed(picture.size());
  constexpr std::size_t kValuesPerDraw = 4;
  constexpr std::size_t kValuesPerChunk = 4096;
  parallel_for_chunks(picture.size(), kValuesPerChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; i += kValuesPerDraw) {
      std::uint64_t bits = random.bits(i / kValuesPerDraw);
      for (std::size_t k = i; k < std::min(end, i + kValuesPerDraw); ++k, bits >>= 16) {
        const float sigma = std::sqrt(read2 + shot2 * picture[k]);
        developed[k] = level(picture[k] + sigma * normal(static_cast<std::uint32_t>(bits)));
      }
    }
  });
  return developed;
}

void CameraSimulator::adjust_gain(const std::vector<std::uint8_t>& picture) {
  double sum = 0;
  for (const std::uint8_t level : picture) sum += level;
  const double mean = std::max(1.0, sum / static_cast<double>(picture.size())) / 255;
  const double factor =
      std::pow(scenario_.imaging.target_level / mean, scenario_.rig.camera.gamma * kExposureSpeed);
  gain_ = std::clamp(gain_ * factor, kLowestGain, kHighestGain);
}

std::vector<std::uint8_t> CameraSimulator::compress(
    const std::vector<std::uint8_t>& picture) const {
  unsigned char* buffer = nullptr;
  unsigned long size = 0;
  const int failed = tjCompress2(jpeg_, picture.data(), scenario_.rig.camera.width, 0,
                                 scenario_.rig.camera.height, TJPF_RGB, &buffer, &size, TJSAMP_422,
                                 scenario_.imaging.jpeg_quality, TJFLAG_ACCURATEDCT);
  const std::unique_ptr<unsigned char, decltype(&tjFree)> owner(buffer, &tjFree);
  if (failed != 0) throw std::runtime_error(std::string("JPEG: ") + tjGetErrorStr2(jpeg_));
  return {buffer, buffer + size};
}

}  // namespace gastronaut

// Any bytes as a picture: a failure in words, or depth within its bounds and albedo; and whatever
// came before, the next good picture works.
#include <turbojpeg.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "depth_estimator/depth_estimator.hpp"
#include "fuzz_check.hpp"

using namespace gastronaut;
using namespace gastronaut::perception;

namespace {

constexpr int kWidth = 32;
constexpr int kHeight = 24;

RigConfiguration small_rig() {
  RigConfiguration rig;
  rig.camera.width = kWidth;
  rig.camera.height = kHeight;
  rig.camera.fx = rig.camera.fy = 16.6;
  rig.camera.cx = 16.2;
  rig.camera.cy = 11.8;
  rig.camera.distortion = {-0.12, 0.018, 0.0002, -0.0001};
  return rig;
}

EncodedPicture good_picture() {
  static const std::vector<std::uint8_t> rgb = [] {
    std::vector<std::uint8_t> pixels;
    for (int i = 0; i < kWidth * kHeight; ++i) {
      const int grain = (i / 5 * 7919 + i / kWidth / 3 * 104729) % 30;
      for (const int level : {160, 100, 90}) {
        pixels.push_back(static_cast<std::uint8_t>(level + grain));
      }
    }
    return pixels;
  }();
  return {kWidth, kHeight, 3 * kWidth, PixelFormat::kRgb, rgb};
}

// Over the pixels that have one; 0: none has.
double median_depth(const Perception& seen) {
  std::vector<float> depths;
  for (const float depth : seen.depth.values) {
    if (depth > 0) depths.push_back(depth);
  }
  if (seen.failure || depths.size() < seen.depth.size() / 2) return 0;
  std::sort(depths.begin(), depths.end());
  return static_cast<double>(depths[depths.size() / 2]);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  static const RigConfiguration rig = small_rig();
  static DepthEstimator estimator(rig);
  static const double fresh = median_depth(DepthEstimator(rig).estimate(good_picture(), 1.0));
  if (size < 5) return 0;
  EncodedPicture picture;
  picture.format = static_cast<PixelFormat>(bytes[0] % 4);
  const bool right_size = bytes[1] % 8 != 0;
  picture.width = right_size ? kWidth : bytes[1] - 4;
  picture.height = right_size ? kHeight : bytes[2] - 4;
  const int channels = picture.format == PixelFormat::kGray ? 1 : 3;
  picture.row_stride = bytes[3] % 4 != 0 ? channels * kWidth : bytes[3] - 128;
  picture.data = {bytes + 5, size - 5};
  // 1e-3 to 1e3, as the process lets through.
  const double gain = std::pow(10.0, 3.0 * (bytes[4] - 128) / 128);

  const Perception& seen = estimator.estimate(picture, gain);
  if (!seen.failure) {
    for (const float depth : seen.depth.values) {
      promise(depth == 0 || (depth >= static_cast<float>(0.99 * rig.depth_estimator.min_depth) &&
                             depth <= static_cast<float>(1.01 * rig.depth_estimator.max_depth)),
              "depth is none or within its bounds");
    }
    promise(seen.relative_std > 0, "depth comes with its uncertainty");
    promise(std::isfinite(seen.quality.sharpness), "sharpness is a number");
  } else {
    for (const float depth : seen.depth.values) promise(depth == 0, "a failure has no depth");
    for (const auto* plane : {&seen.albedo, &seen.vessels}) {
      for (const std::uint8_t level : plane->values) promise(level == 0, "nor albedo and vessels");
    }
  }
  const double now = median_depth(estimator.estimate(good_picture(), 1.0));
  promise(std::abs(now / fresh - 1) < 0.05, "the next good picture works as it always does");
  return 0;
}

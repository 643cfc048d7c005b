#include "depth_estimator/depth_estimator.hpp"

#include <algorithm>
#include <cmath>

#include "numerics/parallel.hpp"

namespace gastronaut::perception {
namespace {

// Where the shading model leaves more than this unexplained (root mean square of ln light over the
// window), the wall folds over, is in shadow or ends, and the depth is no better than a guess.
constexpr float kLargestUnexplained = 0.15F;
// Less of the picture than this explained is none of it.
constexpr double kLeastExplained = 0.03;
// Relative error of the depth over what is unexplained of ln light: 1/2 if it were all distance,
// more since slopes are wrong too; measured on the virtual rig's stomachs.
constexpr double kDepthPerUnexplained = 0.7;
constexpr float kLargestSingle = 1;  // single residuals count as no more than this
constexpr float kLeastDataInWindow = 0.25F;
constexpr int kWindow = 4;  // pixels to each side
constexpr std::size_t kRowsPerChunk = 16;

int picture_pixels_per_grid_pixel(const RigConfiguration& configuration) {
  const int most = configuration.depth_estimator.max_width;
  return (configuration.camera.width + most - 1) / most;
}

PinholeGrid picture_grid(const CameraConfiguration& camera) {
  return {camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy};
}

PinholeGrid depth_grid(const RigConfiguration& configuration) {
  return picture_grid(configuration.camera).coarser(picture_pixels_per_grid_pixel(configuration));
}

// Sums over the window around each pixel, what lies beyond the border being zero.
void sum_over_window(Plane<float>& plane) {
  Plane<float> across(plane.width, plane.height);
  const auto rows = static_cast<std::size_t>(plane.height);
  parallel_for_chunks(rows, kRowsPerChunk, [&](std::size_t begin, std::size_t end) {
    for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
      for (int u = 0; u < plane.width; ++u) {
        const int last = std::min(plane.width - 1, u + kWindow);
        for (int k = std::max(0, u - kWindow); k <= last; ++k) {
          across.at(u, v) += plane.at(k, v);
        }
      }
    }
  });
  parallel_for_chunks(rows, kRowsPerChunk, [&](std::size_t begin, std::size_t end) {
    for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
      float* sums = plane.row(v);
      std::fill_n(sums, plane.width, 0.0F);
      const int last = std::min(plane.height - 1, v + kWindow);
      for (int k = std::max(0, v - kWindow); k <= last; ++k) {
        const float* row = across.row(k);
        for (int u = 0; u < plane.width; ++u) sums[u] += row[u];
      }
    }
  });
}

}  // namespace

DepthEstimator::DepthEstimator(const RigConfiguration& configuration)
    : configuration_(configuration),
      front_end_(configuration.camera),
      vessel_filter_(configuration.camera.width, configuration.camera.height,
                     VesselFilterOptions{.scales = configuration.depth_estimator.vessel_scales}),
      light_divider_(configuration, depth_grid(configuration),
                     picture_pixels_per_grid_pixel(configuration)),
      shape_from_shading_(depth_grid(configuration),
                          NearLight(configuration.camera, configuration.lights),
                          configuration.depth_estimator) {
  perception_.grid = depth_grid(configuration);
}

// A picture's way: linear light, vessels, shading, shape, and the albedo that is left.
const Perception& DepthEstimator::estimate(const EncodedPicture& picture,
                                           std::optional<double> gain) {
  light_.quality = {};
  if (const PictureFailure failure = front_end_.process(picture, light_)) return refuse(failure);
  vessel_filter_.apply(light_.green_level, vessels_);
  perception_.vessels = Plane<std::uint8_t>(vessels_.width, vessels_.height);
  std::transform(vessels_.values.begin(), vessels_.values.end(), perception_.vessels.values.begin(),
                 [](float response) { return static_cast<std::uint8_t>(255 * response + 0.5F); });
  perception_.quality = light_.quality;
  if (configuration_.depth_estimator.depth == DepthSource::kSensor) {
    take_brightness();
    return perception_;
  }
  light_divider_.shade(light_, gain.value_or(1), shading_);
  std::optional<Shape> shape = shape_from_shading_.solve(shading_);
  if (!shape) {
    return refuse({"unlit", "too few lit pixels: the lens is covered or looks into the dark"});
  }
  perception_.depth = std::move(shape->depth);
  const Explained explained = drop_unexplained(shape->log_shading);
  if (explained.fraction < kLeastExplained) {
    return refuse({"unexplained",
                   "the lamp does not explain the picture: wrong gain, foreign light, or nothing "
                   "within depth_estimator.max_depth"});
  }
  shape_from_shading_.remember();
  perception_.failure = {};
  perception_.relative_std = relative_std(gain.has_value(), explained.std);
  light_divider_.divide(light_, gain.value_or(1), shape->log_shading, vessels_, perception_.albedo);
  return perception_;
}

void DepthEstimator::take_brightness() {
  const Plane<float>& level = light_.green_level;
  perception_.failure = {};
  perception_.albedo = Plane<std::uint8_t>(level.width, level.height);
  for (std::size_t i = 0; i < level.size(); ++i) {
    const bool seen = (light_.flags.values[i] & kOutside) == 0;
    // 0 says that there is nothing.
    perception_.albedo.values[i] =
        seen ? static_cast<std::uint8_t>(std::max(1.0F, 255 * level.values[i] + 0.5F)) : 0;
  }
}

const Perception& DepthEstimator::refuse(const PictureFailure& failure) {
  perception_.failure = failure;
  perception_.quality = light_.quality;
  perception_.relative_std = 1;
  for (Plane<std::uint8_t>* plane : {&perception_.albedo, &perception_.vessels}) {
    std::fill(plane->values.begin(), plane->values.end(), std::uint8_t{0});
  }
  std::fill(perception_.depth.values.begin(), perception_.depth.values.end(), 0.0F);
  return perception_;
}

// Depth goes with the square root of light over albedo.
double DepthEstimator::relative_std(bool gain_known, double unexplained_std) const {
  const DepthEstimatorConfiguration& options = configuration_.depth_estimator;
  const double gain_std = gain_known ? 0 : options.unknown_gain_std;
  return std::hypot(std::hypot(options.albedo_std, gain_std) / 2,
                    kDepthPerUnexplained * unexplained_std);
}

DepthEstimator::Explained DepthEstimator::drop_unexplained(const Plane<float>& log_shading) {
  Plane<float> data(log_shading.width, log_shading.height);
  Plane<float> unexplained(log_shading.width, log_shading.height);
  for (std::size_t i = 0; i < data.size(); ++i) {
    if (shading_.inverse_variance.values[i] == 0) continue;
    const float error = std::clamp(shading_.log_light.values[i] - log_shading.values[i],
                                   -kLargestSingle, kLargestSingle);
    data.values[i] = 1;
    unexplained.values[i] = error * error;
  }
  sum_over_window(data);
  sum_over_window(unexplained);
  constexpr float kPixelsInWindow = (2 * kWindow + 1) * (2 * kWindow + 1);
  double kept = 0;
  double squares = 0;
  for (std::size_t i = 0; i < data.size(); ++i) {
    const float count = data.values[i];
    if (count < kLeastDataInWindow * kPixelsInWindow ||
        !(unexplained.values[i] <= kLargestUnexplained * kLargestUnexplained * count)) {
      perception_.depth.values[i] = 0;
      continue;
    }
    kept += 1;
    squares += static_cast<double>(unexplained.values[i] / count);
  }
  return {kept / static_cast<double>(data.size()), kept > 0 ? std::sqrt(squares / kept) : 0};
}

}  // namespace gastronaut::perception

#include "depth_estimator/shading.hpp"

#include <algorithm>
#include <cmath>

#include "numerics/parallel.hpp"
#include "photometry/near_light.hpp"

namespace gastronaut::perception {
namespace {

constexpr std::size_t kRowsPerChunk = 16;
constexpr double kLeastGoodPixels = 0.7;  // of a block, for a channel to count
// Read noise, quantisation at the dark end of the gamma curve and JPEG together, over read noise;
// and their least.
constexpr double kDarkNoiseOverReadNoise = 2;
constexpr double kLeastNoise = 0.001;
constexpr double kDarkestInNoise = 2;     // darker than this many sigmas says nothing of distance
constexpr double kVesselDarkening = 0.5;  // of the albedo, where the vessel response is 1

template <class Body>
void for_row_chunks(int height, const Body& body) {
  parallel_for_chunks(static_cast<std::size_t>(height), kRowsPerChunk,
                      [&](std::size_t begin, std::size_t end) {
                        for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
                          body(v);
                        }
                      });
}

}  // namespace

LightDivider::LightDivider(const RigConfiguration& configuration, const PinholeGrid& grid,
                           int factor)
    : grid_(grid),
      factor_(factor),
      power_(configuration.camera.exposure_gain * configuration.camera.led_intensity),
      noise_(std::max(kLeastNoise, kDarkNoiseOverReadNoise * configuration.camera.read_noise)),
      data_std_(configuration.depth_estimator.data_std),
      log_vignetting_(grid.width, grid.height) {
  std::copy_n(configuration.depth_estimator.albedo.begin(), albedo_.size(), albedo_.begin());
  const NearLight light(configuration.camera, configuration.lights);
  for (int v = 0; v < grid.height; ++v) {
    for (int u = 0; u < grid.width; ++u) {
      const Eigen::Vector3d ray((u - grid.cx) / grid.fx, (v - grid.cy) / grid.fy, 1);
      log_vignetting_.at(u, v) = static_cast<float>(std::log(light.vignetting(ray)));
    }
  }
}

double LightDivider::log_power(double gain) const { return std::log(gain * power_); }

void LightDivider::shade(const LinearPicture& picture, double gain, Shading& shading) const {
  shading.log_light = Plane<float>(grid_.width, grid_.height);
  shading.inverse_variance = Plane<float>(grid_.width, grid_.height);
  const double log_exposure = log_power(gain);
  const auto enough = static_cast<int>(std::ceil(kLeastGoodPixels * factor_ * factor_));
  constexpr std::array<std::uint8_t, 3> kUnusable = {kOutside | kHighlight | kRedSaturated,
                                                     kOutside | kHighlight | kGreenSaturated,
                                                     kOutside | kHighlight | kBlueSaturated};
  for_row_chunks(grid_.height, [&](int v) {
    for (int u = 0; u < grid_.width; ++u) {
      for (std::size_t channel = 0; channel < picture.light.size(); ++channel) {
        float sum = 0;
        int count = 0;
        for (int row = v * factor_; row < (v + 1) * factor_; ++row) {
          const float* light = picture.light[channel].row(row) + u * factor_;
          const std::uint8_t* flags = picture.flags.row(row) + u * factor_;
          for (int k = 0; k < factor_; ++k) {
            const bool good = (flags[k] & kUnusable[channel]) == 0;
            sum += good ? light[k] : 0;
            count += good ? 1 : 0;
          }
        }
        if (count < enough) continue;
        const double light = static_cast<double>(sum) / count;
        // A dark block is dark in the other channels too.
        if (light < kDarkestInNoise * noise_) break;
        const double noise = noise_ / light;
        shading.log_light.at(u, v) =
            static_cast<float>(std::log(light / albedo_[channel]) - log_exposure -
                               static_cast<double>(log_vignetting_.at(u, v)));
        shading.inverse_variance.at(u, v) =
            static_cast<float>(1 / (data_std_ * data_std_ + noise * noise));
        break;
      }
    }
  });
}

void LightDivider::divide(const LinearPicture& picture, double gain,
                          const Plane<float>& log_shading, const Plane<float>& vessels,
                          Plane<std::uint8_t>& albedo) const {
  const int width = picture.flags.width;
  const int height = picture.flags.height;
  albedo = Plane<std::uint8_t>(width, height);
  // Levels per linear light on the grid, interpolated between its pixels' centres.
  Plane<float> levels(grid_.width, grid_.height);
  const double log_exposure = log_power(gain);
  for_row_chunks(grid_.height, [&](int v) {
    for (int u = 0; u < grid_.width; ++u) {
      levels.at(u, v) = static_cast<float>(
          255 * std::exp(-log_exposure - static_cast<double>(log_vignetting_.at(u, v)) -
                         static_cast<double>(log_shading.at(u, v))));
    }
  });
  struct Place {
    int low, high;
    float along;
  };
  const auto place = [&](int pixel, int size) {
    const double at = std::clamp((pixel - (factor_ - 1) / 2.0) / factor_, 0.0, size - 1.0);
    const int low = static_cast<int>(at);
    return Place{low, std::min(low + 1, size - 1), static_cast<float>(at - low)};
  };
  std::vector<Place> columns;
  columns.reserve(static_cast<std::size_t>(width));
  for (int u = 0; u < width; ++u) columns.push_back(place(u, grid_.width));
  parallel_for_chunks(
      static_cast<std::size_t>(height), kRowsPerChunk, [&](std::size_t begin, std::size_t end) {
        std::vector<float> blended(static_cast<std::size_t>(grid_.width));
        for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
          const Place row = place(v, grid_.height);
          const float* low = levels.row(row.low);
          const float* high = levels.row(row.high);
          for (std::size_t u = 0; u < blended.size(); ++u) {
            blended[u] = low[u] + row.along * (high[u] - low[u]);
          }
          const float* green = picture.light[1].row(v);
          const float* vessel = vessels.row(v);
          const std::uint8_t* flags = picture.flags.row(v);
          std::uint8_t* to = albedo.row(v);
          for (int u = 0; u < width; ++u) {
            const Place& column = columns[static_cast<std::size_t>(u)];
            const float left = blended[static_cast<std::size_t>(column.low)];
            const float right = blended[static_cast<std::size_t>(column.high)];
            const float level = (left + column.along * (right - left)) * green[u] *
                                (1 - static_cast<float>(kVesselDarkening) * vessel[u]);
            const bool good = (flags[u] & (kOutside | kHighlight | kGreenSaturated)) == 0;
            to[u] = good ? static_cast<std::uint8_t>(std::clamp(level + 0.5F, 1.0F, 255.0F)) : 0;
          }
        }
      });
}

}  // namespace gastronaut::perception

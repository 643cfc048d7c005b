// Depth pictures against the truth, pixel ray by pixel ray.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace gastronaut::evaluation {

// Undistorted pinhole depth along the optical axis in metres, row by row; 0: none.
struct DepthPicture {
  int width = 0;
  int height = 0;
  double fx = 0;  // pixels
  double fy = 0;
  double cx = 0;
  double cy = 0;
  std::vector<float> depth;
};

enum class DepthEncoding { kRaw, kPng, kZstd };

// Width * height little-endian 16-bit counts; nothing for data that are not just that.
std::optional<std::vector<std::uint16_t>> decode_depth_counts(DepthEncoding encoding,
                                                              std::span<const std::uint8_t> data,
                                                              int width, int height);

// Sums over the truth's pixels. Those with depth are looked up in the estimate along their ray,
// nearest pixel, so size and focal length of the two may differ.
struct DepthErrors {
  std::size_t truth_pixels = 0;     // with true depth
  std::size_t compared_pixels = 0;  // with both
  double sum_absolute = 0;          // metres
  double sum_squared = 0;           // square metres
  double sum_relative = 0;          // |error| / true depth
  double sum_absolute_scaled = 0;   // metres, after median scaling of each picture
  double scale = 0;  // median true depth / median estimated depth, over the compared pixels

  DepthErrors& operator+=(const DepthErrors& other);  // all but scale
  double coverage() const;
  double mean_absolute() const;
  double rmse() const;
  double mean_relative() const;
  double mean_absolute_scaled() const;
};
DepthErrors compare_depth(const DepthPicture& estimate, const DepthPicture& truth);

// The estimate's depth on the truth's pixels, 0 where there is none.
std::vector<float> resample_like(const DepthPicture& estimate, const DepthPicture& truth);

}  // namespace gastronaut::evaluation

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
  double relative_std = 0;  // one sigma as a fraction of the depth; 0: not given
};

// Sums over pixels with an estimate and the truth; error = estimate - truth. Means are NaN without
// pixels.
struct ErrorSums {
  std::size_t count = 0;
  double sum = 0;           // metres
  double sum_absolute = 0;  // metres
  double sum_squared = 0;   // square metres
  double sum_relative = 0;  // |error| / true depth

  void add(double estimate, double truth);
  ErrorSums& operator+=(const ErrorSums& other);
  double bias() const;
  double mean_absolute() const;
  double rmse() const;
  double mean_relative() const;
};

// Sums over the truth's pixels. Those with depth are looked up in the estimate along their ray,
// nearest pixel, so size and focal length of the two may differ.
struct DepthErrors {
  std::size_t truth_pixels = 0;    // with true depth
  ErrorSums compared;              // with both
  double sum_absolute_scaled = 0;  // metres, after median scaling of each picture
  // Of error / (relative_std * estimate), over the pictures that give relative_std.
  std::size_t normalised_pixels = 0;
  double sum_normalised_squared = 0;
  double scale = 0;  // median true depth / median estimated depth, over the compared pixels

  DepthErrors& operator+=(const DepthErrors& other);  // all but scale
  double coverage() const;
  double mean_absolute_scaled() const;
  // RMS; 1 where relative_std tells the truth.
  double normalised_error() const;
};

// The errors by true depth, in bins.
class DepthProfile {
 public:
  struct Bin {
    std::size_t truth_pixels = 0;
    ErrorSums compared;
  };
  static constexpr double kBinWidth = 0.0025;  // metres
  static constexpr std::size_t kBins = 80;     // and one more for all that is further

  Bin& at(double true_depth);
  // Of the true depths from `near` to below `far` (metres), multiples of kBinWidth.
  Bin between(double near, double far) const;
  const std::vector<Bin>& bins() const { return bins_; }

 private:
  std::vector<Bin> bins_ = std::vector<Bin>(kBins + 1);
};

// Adds to `profile`, too.
DepthErrors compare_depth(const DepthPicture& estimate, const DepthPicture& truth,
                          DepthProfile& profile);

// The estimate's depth on the truth's pixels, 0 where there is none.
std::vector<float> resample_like(const DepthPicture& estimate, const DepthPicture& truth);

}  // namespace gastronaut::evaluation

#include "evaluate/depth_errors.hpp"

#include <algorithm>
#include <cmath>

namespace gastronaut::evaluation {
namespace {

float median(std::vector<float>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double ratio(double sum, std::size_t count) { return sum / static_cast<double>(count); }

}  // namespace

void ErrorSums::add(double estimate, double truth) {
  const double error = estimate - truth;
  ++count;
  sum += error;
  sum_absolute += std::abs(error);
  sum_squared += error * error;
  sum_relative += std::abs(error) / truth;
}

ErrorSums& ErrorSums::operator+=(const ErrorSums& other) {
  count += other.count;
  sum += other.sum;
  sum_absolute += other.sum_absolute;
  sum_squared += other.sum_squared;
  sum_relative += other.sum_relative;
  return *this;
}

double ErrorSums::bias() const { return ratio(sum, count); }
double ErrorSums::mean_absolute() const { return ratio(sum_absolute, count); }
double ErrorSums::rmse() const { return std::sqrt(ratio(sum_squared, count)); }
double ErrorSums::mean_relative() const { return ratio(sum_relative, count); }

DepthErrors& DepthErrors::operator+=(const DepthErrors& other) {
  truth_pixels += other.truth_pixels;
  compared += other.compared;
  sum_absolute_scaled += other.sum_absolute_scaled;
  normalised_pixels += other.normalised_pixels;
  sum_normalised_squared += other.sum_normalised_squared;
  return *this;
}

double DepthErrors::coverage() const {
  return ratio(static_cast<double>(compared.count), truth_pixels);
}
double DepthErrors::mean_absolute_scaled() const {
  return ratio(sum_absolute_scaled, compared.count);
}
double DepthErrors::normalised_error() const {
  return std::sqrt(ratio(sum_normalised_squared, normalised_pixels));
}

DepthProfile::Bin& DepthProfile::at(double true_depth) {
  const double bin = true_depth / kBinWidth;
  return bins_[bin < static_cast<double>(kBins) ? static_cast<std::size_t>(bin) : kBins];
}

DepthProfile::Bin DepthProfile::between(double near, double far) const {
  const auto edge = [](double depth) {
    return static_cast<std::size_t>(std::min<double>(std::round(depth / kBinWidth), kBins + 1));
  };
  Bin total;
  for (std::size_t i = edge(near); i < edge(far); ++i) {
    total.truth_pixels += bins_[i].truth_pixels;
    total.compared += bins_[i].compared;
  }
  return total;
}

std::vector<float> resample_like(const DepthPicture& estimate, const DepthPicture& truth) {
  const auto nearest = [](double ray, double focal_length, double centre, int size) {
    const double pixel = std::round(focal_length * ray + centre);
    return pixel >= 0 && pixel < size ? static_cast<int>(pixel) : -1;
  };
  std::vector<int> columns(static_cast<std::size_t>(truth.width));
  for (std::size_t u = 0; u < columns.size(); ++u) {
    columns[u] = nearest((static_cast<double>(u) - truth.cx) / truth.fx, estimate.fx, estimate.cx,
                         estimate.width);
  }
  std::vector<float> result;
  result.reserve(truth.depth.size());
  for (int v = 0; v < truth.height; ++v) {
    const int row = nearest((v - truth.cy) / truth.fy, estimate.fy, estimate.cy, estimate.height);
    for (const int column : columns) {
      result.push_back(row < 0 || column < 0
                           ? 0.0F
                           : estimate.depth[static_cast<std::size_t>(row) *
                                                static_cast<std::size_t>(estimate.width) +
                                            static_cast<std::size_t>(column)]);
    }
  }
  return result;
}

DepthErrors compare_depth(const DepthPicture& estimate, const DepthPicture& truth,
                          DepthProfile& profile) {
  const std::vector<float> resampled = resample_like(estimate, truth);
  DepthErrors errors;
  std::vector<float> estimated;
  std::vector<float> expected;
  for (std::size_t i = 0; i < resampled.size(); ++i) {
    if (truth.depth[i] <= 0) continue;
    DepthProfile::Bin& bin = profile.at(truth.depth[i]);
    ++errors.truth_pixels;
    ++bin.truth_pixels;
    if (resampled[i] <= 0) continue;
    errors.compared.add(resampled[i], truth.depth[i]);
    bin.compared.add(resampled[i], truth.depth[i]);
    estimated.push_back(resampled[i]);
    expected.push_back(truth.depth[i]);
  }
  if (estimated.empty()) return errors;
  std::vector<float> sorted = estimated;
  const double estimated_median = median(sorted);
  sorted = expected;
  errors.scale = median(sorted) / estimated_median;
  for (std::size_t i = 0; i < estimated.size(); ++i) {
    const double depth = estimated[i];
    errors.sum_absolute_scaled += std::abs(errors.scale * depth - static_cast<double>(expected[i]));
    if (estimate.relative_std <= 0) continue;
    const double normalised =
        (depth - static_cast<double>(expected[i])) / (estimate.relative_std * depth);
    ++errors.normalised_pixels;
    errors.sum_normalised_squared += normalised * normalised;
  }
  return errors;
}

}  // namespace gastronaut::evaluation

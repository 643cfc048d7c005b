#include "evaluate/surface_thickness.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "evaluate/point_grid.hpp"
#include "evaluate/surface_errors.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr double kLeastCosine = 0.5;    // of the angle between normals
constexpr std::size_t kLeastCount = 6;  // surfels whose standard deviation says something

// As parts of the working distance: 0.7, 4 and 0.5 mm of the 40 mm of a stomach.
constexpr double kRadius = 0.0175;
constexpr double kHalfHeight = 0.1;
constexpr double kDouble = 0.0125;  // half of the distance of two layers

}  // namespace

std::vector<double> surface_thickness(std::span<const Surfel> surfels,
                                      const ThicknessOptions& options) {
  Points points;
  points.reserve(surfels.size());
  for (const Surfel& surfel : surfels) points.push_back(surfel.position.cast<double>());
  const PointGrid grid(points, std::hypot(options.radius, options.half_height));
  const std::size_t step = surfels.size() / options.most_surfels + 1;
  std::vector<double> result((surfels.size() + step - 1) / step);
  constexpr std::size_t kChunk = 64;
  parallel_for_chunks(result.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    std::vector<double> heights;
    for (std::size_t k = begin; k < end; ++k) {
      const std::size_t centre = k * step;
      const Eigen::Vector3d normal = surfels[centre].normal.cast<double>();
      heights.clear();
      grid.visit_around(points[centre], [&](std::size_t i, const Eigen::Vector3d& point) {
        const Eigen::Vector3d difference = point - points[centre];
        const double height = difference.dot(normal);
        if (std::abs(height) <= options.half_height &&
            (difference - height * normal).norm() <= options.radius &&
            surfels[i].normal.cast<double>().dot(normal) > kLeastCosine) {
          heights.push_back(height);
        }
      });
      result[k] = heights.size() < kLeastCount ? std::numeric_limits<double>::quiet_NaN()
                                               : statistics(heights).std;
    }
  });
  std::erase_if(result, [](double value) { return std::isnan(value); });
  return result;
}

void set_thickness_metrics(Metrics& metrics, std::span<const Surfel> surfels,
                           double working_distance) {
  const std::vector<double> thickness = surface_thickness(
      surfels,
      {.radius = kRadius * working_distance, .half_height = kHalfHeight * working_distance});
  if (thickness.empty()) return;
  const std::string key = "surface.thickness";
  metrics.set_count(key + ".count", thickness.size());
  metrics.set(key + ".mean", statistics(thickness).mean);
  metrics.set(key + ".median", quantile(thickness, 0.5));
  metrics.set(key + ".p90", quantile(thickness, 0.9));
  metrics.set(key + ".share_double", 1 - share_within(thickness, kDouble * working_distance));
}

}  // namespace gastronaut::evaluation

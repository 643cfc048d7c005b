// Surfaces of surfels for the tests of the deformation graph.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>

#include "visual_slam/deformation_graph.hpp"
#include "visual_slam/surfel_arrays.hpp"

namespace gastronaut::slam {

inline constexpr double kMillimetre = 1e-3;
inline constexpr std::int64_t kSecond = 1'000'000;  // utime
inline constexpr double kSpacing = 5 * kMillimetre;
inline constexpr double kSurfelDistance = 0.5 * kMillimetre;
inline constexpr float kSurfelRadius = 0.5e-3F;

inline DeformationGraphOptions graph_options() {
  DeformationGraphOptions options;
  options.spacing = kSpacing;
  options.time_reach = 1;
  return options;
}

inline void add_surfel(SurfelArrays& surfels, const Eigen::Vector3d& position,
                       const Eigen::Vector3d& normal, const TimeSpan& seen) {
  const std::size_t k = surfels.size();
  surfels.resize(k + 1);
  surfels.x[k] = static_cast<float>(position.x());
  surfels.y[k] = static_cast<float>(position.y());
  surfels.z[k] = static_cast<float>(position.z());
  surfels.nx[k] = static_cast<float>(normal.x());
  surfels.ny[k] = static_cast<float>(normal.y());
  surfels.nz[k] = static_cast<float>(normal.z());
  surfels.confidence[k] = 20;
  surfels.radius[k] = kSurfelRadius;
  surfels.initialised[k] = seen.first;
  surfels.updated[k] = seen.last;
}

// A flat sheet in x and y about the origin of height z, metres, seen from above.
inline void add_sheet(SurfelArrays& surfels, double width, double length, double z,
                      const TimeSpan& seen) {
  for (int i = 0; i <= std::lround(width / kSurfelDistance); ++i) {
    for (int j = 0; j <= std::lround(length / kSurfelDistance); ++j) {
      const Eigen::Vector3d point(i * kSurfelDistance - width / 2, j * kSurfelDistance - length / 2,
                                  z);
      add_surfel(surfels, point, Eigen::Vector3d::UnitZ(), seen);
    }
  }
}

inline SurfelArrays sheet(double width, double length, const TimeSpan& seen = {}) {
  SurfelArrays surfels;
  add_sheet(surfels, width, length, 0, seen);
  return surfels;
}

inline Eigen::Vector3d position_of(const SurfelArrays& surfels, std::size_t k) {
  return Eigen::Vector3f(surfels.x[k], surfels.y[k], surfels.z[k]).cast<double>();
}
inline Eigen::Vector3d normal_of(const SurfelArrays& surfels, std::size_t k) {
  return Eigen::Vector3f(surfels.nx[k], surfels.ny[k], surfels.nz[k]).cast<double>();
}
inline TimeSpan seen_of(const SurfelArrays& surfels, std::size_t k) {
  return {surfels.initialised[k], surfels.updated[k]};
}

}  // namespace gastronaut::slam

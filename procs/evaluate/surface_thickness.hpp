// How thick the map's surface is: a place that was seen twice and not brought together has two
// layers.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "evaluate/metrics.hpp"
#include "surfels/surfel_store.hpp"

namespace gastronaut::evaluation {

struct ThicknessOptions {
  double radius = 0;                // metres, of the piece of surface around a surfel
  double half_height = 0;           // metres: so far along the normal a surfel may be another layer
  std::size_t most_surfels = 5000;  // at which it is measured, spread over all
};

// For surfels spread over the map, the standard deviation (metres) along its normal of those around
// it, itself among them, whose normals are within 60 degrees of its own. Two layers at a distance d
// with as many surfels each give d / 2. A surfel with next to none around it is left out.
std::vector<double> surface_thickness(std::span<const Surfel> surfels,
                                      const ThicknessOptions& options);

// surface.thickness.count, .mean, .median, .p90 (metres) and .share_double, the share that is like
// two layers at least a fortieth of the working distance (1 mm of 40 mm) apart. Lengths go by
// visual_slam.working_distance (metres). Nothing for too few surfels.
void set_thickness_metrics(Metrics& metrics, std::span<const Surfel> surfels,
                           double working_distance);

}  // namespace gastronaut::evaluation

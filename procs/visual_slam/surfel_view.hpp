// The map as it would look from a pose: surfels drawn as discs.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "visual_slam/frame.hpp"
#include "visual_slam/surfel_arrays.hpp"

namespace gastronaut::slam {

struct SplatOptions {
  double farthest = 0;           // metres along the optical axis; centres beyond are not drawn
  double minimum_cosine = 0.15;  // between a normal and the way to the camera; less: not drawn
  // Discs that a ray meets within this fraction of depth behind the nearest are one surface.
  double surface_thickness = 0.05;
  std::int64_t active_since = INT64_MIN;  // utime; surfels last updated before are not drawn
  std::int64_t known_before = INT64_MAX;  // utime; surfels made then or later are not drawn
};

// Draws the surfels whose ids are in `groups` as view.grid sees them from view.map_T_camera, and
// fills all planes of the view. Each disc is cut exactly where a pixel's ray meets its plane. A
// pixel shows the mean of the nearest surface's discs there, each weighted by its confidence and by
// how near to its centre it is met: the nearest alone would always be the one that errs towards the
// camera. The surfel named is the one met nearest to its centre, of equals the lowest id. The
// number of threads changes nothing. Discs that reach behind the camera are not drawn.
void splat(const SurfelArrays& surfels, const std::vector<std::span<const std::int32_t>>& groups,
           const SplatOptions& options, ModelView& view);

}  // namespace gastronaut::slam

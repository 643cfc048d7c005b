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
  std::int64_t active_since = INT64_MIN;  // utime; surfels last updated before are not drawn
};

// Draws the surfels whose ids are in `groups` as view.grid sees them from view.map_T_camera, and
// fills all planes of the view. Each disc is cut exactly where a pixel's ray meets its plane; at a
// pixel the nearest wins, of equally near ones the lowest id: neither the order of the groups nor
// the number of threads changes anything. Discs that reach behind the camera are not drawn.
void splat(const SurfelArrays& surfels, const std::vector<std::span<const std::int32_t>>& groups,
           const SplatOptions& options, ModelView& view);

}  // namespace gastronaut::slam

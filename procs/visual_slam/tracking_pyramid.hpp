// Frame and model view as the tracker compares them: three levels, each half as wide and high as
// the one before, with the albedo normalised to its surroundings' contrast on every level.
#pragma once

#include <array>

#include "camera/pinhole_grid.hpp"
#include "image/plane.hpp"
#include "visual_slam/frame.hpp"

namespace gastronaut::slam {

inline constexpr int kTrackingLevels = 3;
// Columns are handled this many at a time, and sums are taken in this many lanes, whatever the
// processor has: results do not depend on it.
inline constexpr int kTrackingLanes = 16;

struct PyramidOptions {
  double jump = 0.05;            // depths further apart, as a fraction, are two surfaces
  double contrast_floor = 0.02;  // added to the local deviation, as a fraction of the local mean:
                                 // contrasts below it are taken for noise
};

// Planes are padded on the right to whole vectors. NaN: nothing there.
struct FrameLevel {
  PinholeGrid grid;
  Plane<float> depth;       // metres
  Plane<float> raw_albedo;  // as in Frame
  Plane<float> albedo;      // (raw - local mean) / (local deviation + floor)
  double pixel = 1;         // side of a pixel in those of the finest level
  double roughness = 0;     // one sigma of the depth's own noise as a fraction of depth
};

struct ModelLevel : FrameLevel {
  Plane<float> normal_x, normal_y, normal_z;  // towards the camera, of any length
  Plane<float> gradient_x, gradient_y;        // of albedo, per pixel
};

using FramePyramid = std::array<FrameLevel, kTrackingLevels>;
using ModelPyramid = std::array<ModelLevel, kTrackingLevels>;

// Room for pictures of this grid, used again for each.
FramePyramid frame_pyramid(const PinholeGrid& grid);
ModelPyramid model_pyramid(const PinholeGrid& grid);

void fill(const Frame& frame, const PyramidOptions& options, FramePyramid& pyramid);
void fill(const ModelView& model, const PyramidOptions& options, ModelPyramid& pyramid);

}  // namespace gastronaut::slam

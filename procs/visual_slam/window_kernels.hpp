// The keyframe window's loop over pixels, compiled for each instruction set and chosen when the
// program runs. The same operations in the same order on all of them.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "visual_slam/tracking_kernels.hpp"

namespace gastronaut::slam {

// A point is seen as a patch of so many pixels, which have the shape that the host's depth gives.
inline constexpr std::size_t kPatchPixels = 8;
using PatchLanes = std::array<float, kPatchPixels>;

struct WindowPoint {
  PatchLanes ray_x, ray_y;  // of the host's pixels, at depth one
  PatchLanes depth;         // metres, as the host's frame had it
  PatchLanes value;         // normalised albedo
  int u = 0;                // the middle one
  int v = 0;
};

// A keyframe as others look at it. NaN: nothing there.
struct Texel {
  float value;       // normalised albedo
  float gradient_x;  // of it, per pixel
  float gradient_y;
  float depth;  // metres
};
struct Texture {
  PinholeGrid grid;
  std::vector<Texel> texels;  // row by row
};

// From the host of the points to the keyframe that looks at them.
struct PatchView {
  std::array<float, 9> target_R_host;  // row by row
  std::array<float, 3> target_t_host;  // metres
  float target_scale = 1;              // the target's depth is multiplied by it
  float depth_gate = 0;                // as a fraction: further off the target's depth is hidden
  float value_gate = 0;                // normalised albedo
  float sigma = 1;                     // of normalised albedo; scales the robust weights
};

inline constexpr std::size_t kTwist = 6;

// Sums w J J^T and so on over the pixels of one patch; J by the twist xi of exp(xi) *
// target_T_host, r the residual: target minus host. w: Cauchy's weight.
struct PatchSums {
  std::array<float, kTwist> twist_ratio;  // by the twist and by the log of the point's depth
  float ratio2 = 0;
  float ratio_residual = 0;
  float weight = 0;  // 0: the target does not see the point
  float square = 0;  // w r^2
};
struct ViewSums {
  std::array<double, triangle(kTwist)> matrix{};  // w J J^T, upper triangle, row by row
  std::array<double, kTwist> vector{};            // w J r
};

// points[i] is looked at where its depths are ratios[i] times those it has.
ViewSums look_at_patches(const std::vector<WindowPoint>& points, const std::vector<float>& ratios,
                         const Texture& target, const PatchView& view,
                         std::vector<PatchSums>& patches);

}  // namespace gastronaut::slam

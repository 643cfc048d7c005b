// Keyframes as the window looks at them, and the points at which it does.
#pragma once

#include <vector>

#include "visual_slam/frame.hpp"
#include "visual_slam/window_kernels.hpp"

namespace gastronaut::slam {

// Albedo as (a - mean) / (deviation + floor * mean) over a square window that reaches so many
// pixels from its middle. Nothing where the picture's border cuts the window or where most of it is
// masked.
Texture texture_of(const Frame& frame, int reach, double floor);

// The pixel with the steepest albedo in each square of a grid; none in a square where nothing
// exceeds least_gradient (per pixel), lies on one surface (neighbours' depths differ by less than
// `jump`, a fraction) and is seen whole. About as many as wanted: where squares are empty, all are
// smaller.
std::vector<WindowPoint> select_points(const Texture& texture, int points, double least_gradient,
                                       double jump);

}  // namespace gastronaut::slam

// Normals of a measured depth picture, steady enough under its noise to be fused.
#pragma once

#include "camera/pinhole_grid.hpp"
#include "image/plane.hpp"

namespace gastronaut::slam {

struct NormalMap {
  Plane<float> x, y, z;  // unit, camera frame, towards the camera; all 0: none
};

// On a plane, inverse depth is an affine function of the pixel. Its slopes are fitted over
// 5 x 5 pixels to pairs of pixels opposite about the middle one, so that curvature drops out.
// A pair counts if both have depth and their mean inverse depth is that of the middle within
// `bend` (a fraction): pairs across an edge do not. Pixels with fewer pairs than 3 x 3 pixels give,
// such as those at the border and beside holes, get no normal. depth: metres, finite and
// positive where there is any; else it is none.
void estimate_normals(const Plane<float>& depth, const PinholeGrid& grid, double bend,
                      NormalMap& normals);

}  // namespace gastronaut::slam

// The loops of shape_from_shading over rows [begin, end) of a grid, compiled for each instruction
// set and chosen when the program runs. The same operations in the same order on all of them.
#pragma once

#include <vector>

#include "depth_estimator/shape_grid.hpp"

namespace gastronaut::perception {

struct ShapeLights {
  std::vector<float> x;  // metres, camera frame; they lie in the lens plane
  std::vector<float> y;
  float lobe = 0;
};

struct ShapeWeights {
  float cauchy = 0;        // residuals beyond this many sigmas lose their say
  float smoothness = 0;    // metres: typical radius of the wall's curvature
  float damping = 0;       // added to A's diagonal
  float cosine_floor = 0;  // patches turned further from the light are taken as in shadow
};

// Residuals, their derivatives by zeta and its first differences, robust weights.
void linearise(ShapeGrid& grid, const ShapeLights& lights, const ShapeWeights& weights, int begin,
               int end);
// A and gradient; step = 0, remainder, preconditioned and direction as conjugate gradients start.
// Returns remainder . preconditioned.
double assemble(ShapeGrid& grid, const ShapeWeights& weights, int begin, int end);
// product = A direction. Returns direction . product.
double multiply(ShapeGrid& grid, int begin, int end);
// step += alpha direction; remainder -= alpha product; preconditioned. Returns remainder .
// preconditioned.
double advance(ShapeGrid& grid, float alpha, int begin, int end);
// direction = preconditioned + beta direction.
void turn(ShapeGrid& grid, float beta, int begin, int end);

}  // namespace gastronaut::perception

// Metric depth from the shading of one picture, lights beside the lens.
//
// Unknown is zeta = ln(depth) on a pinhole grid. A pixel's light, divided by exposure, vignetting,
// mean albedo and LED power, is
//   ln light = ln(N . W(P)) - ln(|N|^2) / 2 + error,   N = (zx, zy, -(1 + x zx + y zy)),
// W the lights' irradiance vector (photometry/near_light.hpp), (zx, zy) the derivatives of zeta by
// the ray (x, y, 1): inverse-square fall-off, Lambert's cosine and the perspective camera in one.
// Minimised are Cauchy-weighted errors plus edge-preserving squared curvature, by Gauss-Newton with
// Jacobi-preconditioned conjugate gradients, coarse to fine, numbers of iterations fixed.
// Smoothness is part of the same system: a fixed-point iteration on smoothed normals would lose the
// scale.
#pragma once

#include <optional>
#include <vector>

#include "configuration/rig_configuration.hpp"
#include "depth_estimator/shape_grid.hpp"
#include "depth_estimator/shape_kernels.hpp"
#include "image/plane.hpp"
#include "photometry/near_light.hpp"

namespace gastronaut::perception {

// What shape_from_shading is given, one value a pixel of the grid.
struct Shading {
  Plane<float> log_light;         // ln of light / (exposure vignetting albedo led_intensity), 1/m^2
  Plane<float> inverse_variance;  // of log_light; 0 where there is no data
};

struct Shape {
  Plane<float> depth;        // metres along the optical axis, everywhere
  Plane<float> log_shading;  // what the model says log_light is
};

class ShapeFromShading {
 public:
  ShapeFromShading(const PinholeGrid& grid, const NearLight& light,
                   const DepthEstimatorConfiguration& options);

  // Nothing where too few pixels carry data. The shape that was last remembered is part of the
  // start, so the order of the pictures matters.
  std::optional<Shape> solve(const Shading& shading);
  // The last solution was good: the next picture starts from it too.
  void remember();

 private:
  ShapeWeights weights() const;
  void load(const Shading& shading);
  static void find_edges(ShapeGrid& grid);
  bool start_coarsest();
  void recall(ShapeGrid& grid) const;
  void refine_from(const ShapeGrid& coarse, ShapeGrid& fine) const;
  void minimise(ShapeGrid& grid, int steps, int inner_steps);

  DepthEstimatorConfiguration options_;
  ShapeLights lights_;
  std::vector<ShapeGrid> grids_;  // fine to coarse
  std::size_t memory_level_ = 0;
  BorderedPlane memory_;  // the remembered zeta on memory_level_; empty before the first
};

}  // namespace gastronaut::perception

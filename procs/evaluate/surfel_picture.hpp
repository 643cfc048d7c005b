// Pictures of a map of surfels, drawn as discs: what lies within a disc's radius of the nearest one
// is blended (Zwicker et al., "Surface splatting", SIGGRAPH 2001, without its filter). Discs that
// face away are left out, so that a cavity seen from outside shows its far wall.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "camera/pinhole_grid.hpp"
#include "evaluate/pictures.hpp"
#include "geometry/se3.hpp"
#include "image/plane.hpp"
#include "surfels/surfel_store.hpp"

namespace gastronaut::evaluation {

struct Viewpoint {
  PinholeGrid grid;  // of the picture
  SE3 world_T_view;  // x right, y down, z forward
};

// The same view in factor x factor as many pixels.
PinholeGrid finer(const PinholeGrid& grid, int factor);

// What is seen at each pixel, with a few pixels for each of the picture's.
struct SurfelDrawing {
  PinholeGrid grid;
  SE3 world_T_view;
  Plane<float> depth;             // metres along z; 0: nothing
  Plane<Eigen::Vector3f> normal;  // unit, view frame
  Plane<Eigen::Vector3f> colour;  // red, green, blue, 0..1
  Plane<float> value;             // of `values`
  Plane<float> light;             // of a lamp beside the eye, 0..1, less where folds hide it
};

// `surfels` in the world frame; `values`: one a surfel, or none. The same whatever the threads.
SurfelDrawing draw_surfels(std::span<const Surfel> surfels, std::span<const float> values,
                           const Viewpoint& viewpoint);

enum class Look {
  kShape,    // one matt material under a lamp beside the eye
  kColour,   // the surfels' own colour, little shaded
  kValue,    // values from 0 to `value_limit` by value_colour, little shaded
  kNormals,  // red: to the right, green: up, blue: to the eye, each from -1 to 1
};

struct Line {
  std::vector<Eigen::Vector3d> points;  // metres, world frame
  std::array<std::uint8_t, 3> colour;   // blue, green, red
  int half_width = 1;                   // pixels
};

ColourPicture paint(const SurfelDrawing& drawing, Look look, float value_limit,
                    std::span<const Line> lines);

// Share of the picture where there is a surfel, 0..1.
double covered(const SurfelDrawing& drawing);

// The colour map "viridis": dark blue for 0, by green to yellow for 1. Blue, green, red.
inline constexpr const char* kValueColours = "viridis";
std::array<std::uint8_t, 3> value_colour(float share);

// Views from outside on what faces them most: up to `count`, at least 50 degrees apart, the best
// first, each with the map and the points of `path` filling a picture of that width and at most
// that height.
std::vector<Viewpoint> outside_views(std::span<const Surfel> surfels,
                                     std::span<const Eigen::Vector3d> path, std::size_t count,
                                     int width, int most_height);

}  // namespace gastronaut::evaluation

// Where to put a map that no trajectory places: by pairs of points that somebody picked, as the
// paper does before its ICP, or by its shape alone.
#pragma once

#include <Eigen/Core>
#include <span>
#include <string>
#include <vector>

#include "evaluate/surface_errors.hpp"
#include "evaluate/true_surface.hpp"
#include "geometry/se3.hpp"

namespace gastronaut::evaluation {

struct PointPair {
  Eigen::Vector3d map;      // metres, map frame
  Eigen::Vector3d surface;  // metres, rig frame
};

// Rows of map x, y, z, surface x, y, z in metres, separated by commas; a first row of names, empty
// rows and rows that start with # are passed over. Throws std::runtime_error naming file and line
// for what is no pair.
std::vector<PointPair> read_pairs(const std::string& path);

// The rig_T_map that brings the picked points of the map closest to those of the surface (Umeyama,
// PAMI 13(4), 1991, without scale). Throws std::invalid_argument for fewer than three pairs and for
// pairs that lie on a line, on either side: they leave a rotation open.
SE3 place_by_pairs(std::span<const PointPair> pairs);

struct ShapePlacement {
  SE3 rig_T_map;
  double rmse = 0;  // metres, of the map's distances there
  // The same at the best of the other places, nan for none: one hardly worse says that the shape
  // alone does not tell where the map belongs.
  double next_rmse = 0;
};
// Iterated closest points from many starts, coarse to fine: from rotations spread evenly and from
// the principal axes, with the map's centre at the surface's and, for a map of a part, at centres
// of parts of the surface of the map's size. Deterministic. The points must not be empty.
ShapePlacement place_by_shape(const TrueSurface& surface, const Points& map_points);

}  // namespace gastronaut::evaluation

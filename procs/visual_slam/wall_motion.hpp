// What a rigid pose leaves unexplained: where a keyframe sees the wall elsewhere than the map has
// it (paper, non-rigid frame-to-model registration).
//
// Depths are compared by patches, each by its median, so that edges and shine decide nothing. A
// patch has moved if it is off by more than the depth's own errors make plausible, as a whole, and
// in company. Without such patches the wall is rigid, and left alone; with them, all that is in
// view goes to where it is seen: a patch that has not moved stays.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "visual_slam/frame.hpp"

namespace gastronaut::slam {

struct WallMotionOptions {
  int patches = 16;          // across the picture
  double least_known = 0.5;  // of a patch's pixels: seen in both
  double least_sigmas = 4;   // of the frame's relative_std, to have moved;
  double least_share = 2;    // and so many times the scatter within the patch
  double largest = 0.3;      // of depth: beyond, it is another surface, not a wall that moved
  int least_patches = 8;     // that have moved, in one piece
};

// A piece of wall in view, camera frame of the keyframe.
struct WallPatch {
  std::size_t pixel = 0;   // its middle
  Eigen::Vector3d in_map;  // metres, where the map has it,
  Eigen::Vector3d seen;    // and where it is seen; the same if it has not moved
  Eigen::Vector3d normal;  // unit, towards the camera
};

// The patches in view where part of the wall has moved; none where it is rigid. `view`: the map
// from where the keyframe's camera is, same grid.
std::vector<WallPatch> find_wall_motion(const Frame& keyframe, const ModelView& view,
                                        const WallMotionOptions& options);

}  // namespace gastronaut::slam

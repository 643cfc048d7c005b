// One picture as tracking and mapping see it, and the map as it would look from a pose.
#pragma once

#include <cstdint>

#include "camera/pinhole_grid.hpp"
#include "geometry/se3.hpp"
#include "image/plane.hpp"

namespace gastronaut::slam {

// Vertex of pixel (u, v): depth * ((u - cx) / fx, (v - cy) / fy, 1), camera frame.
struct Frame {
  std::int64_t utime = 0;
  PinholeGrid grid;
  Plane<float> depth;       // metres along the optical axis; 0: none
  Plane<float> albedo;      // luminance without the lamp, 0 to 1; negative: none
  double relative_std = 0;  // one sigma of depth as a fraction of it
};

struct ModelView {
  SE3 map_T_camera;
  PinholeGrid grid;
  Plane<float> depth;                         // as in Frame; 0: the map has nothing there
  Plane<float> normal_x, normal_y, normal_z;  // unit, camera frame, towards the camera
  Plane<float> albedo;                        // as in Frame
  Plane<float> confidence;                    // of the surfel seen, see surfel_map.hpp
  Plane<std::int32_t> surfel;                 // its stable id; -1: none
};

}  // namespace gastronaut::slam

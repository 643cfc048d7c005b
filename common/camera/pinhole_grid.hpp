// The pixels of an undistorted picture: pixel (u, v) looks along (x, y, 1) =
// ((u - cx) / fx, (v - cy) / fy, 1) in the camera frame.
#pragma once

namespace gastronaut {

struct PinholeGrid {
  int width = 0;  // pixels
  int height = 0;
  double fx = 0;
  double fy = 0;
  double cx = 0;
  double cy = 0;

  bool operator==(const PinholeGrid&) const = default;

  // The grid of blocks of factor x factor pixels; what does not fill a block is left out.
  PinholeGrid coarser(int factor) const {
    const double shift = (factor - 1) / 2.0;
    return {width / factor, height / factor,       fx / factor,
            fy / factor,    (cx - shift) / factor, (cy - shift) / factor};
  }
};

}  // namespace gastronaut

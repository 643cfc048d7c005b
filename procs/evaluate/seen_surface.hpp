// The map against the wall as it was when each surfel was last measured: while the wall moves, a
// map cannot be nearer to the wall at rest than the wall itself was.
#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "evaluate/depth_errors.hpp"
#include "geometry/se3.hpp"
#include "surfels/surfel_store.hpp"

namespace gastronaut::evaluation {

class SeenSurface {
 public:
  // Surfels of the map's frame, and where that is.
  SeenSurface(std::span<const Surfel> surfels, const SE3& rig_T_map);

  // Frames in order of utime. What of the surfels the true camera saw is compared with the picture:
  // those in it, towards it, not measured before it, and at a depth within a fifth of the true one.
  void add(std::int64_t utime, const DepthPicture& truth, const SE3& rig_T_camera);

  // From each surfel that was seen to the tangent plane of the true surface in the last picture
  // that saw it, by its measured_utime: metres, without sign. (A message may be late, so a surfel
  // may be compared with a picture a little after the one that it was measured in.)
  std::vector<double> distances() const;

 private:
  struct Point {
    Eigen::Vector3d position;  // metres, rig frame
    Eigen::Vector3d normal;
    std::int64_t measured_utime;
    double distance = std::numeric_limits<double>::quiet_NaN();
  };
  std::vector<Point> points_;
};

}  // namespace gastronaut::evaluation

// The peer: OpenCV's joint photometric and geometric odometry from frame to frame, in our world.
#pragma once

#include <cstdint>
#include <opencv2/rgbd/depth.hpp>
#include <optional>
#include <vector>

#include "camera/pinhole_grid.hpp"
#include "geometry/se3.hpp"
#include "image/plane.hpp"

namespace gastronaut::slam {

// OpenCV's defaults are meant for a room, so depth is scaled until the working distance is a
// room's; that scales all its gates, and its normals' noise model, at once.
class OpencvOdometry {
 public:
  // working_distance: metres; farthest: depth beyond is not used, in working distances.
  OpencvOdometry(const PinholeGrid& grid, double working_distance, double farthest);

  // previous_T_current; nothing for the first frame and where OpenCV refuses. depth: metres, 0
  // where there is none; levels: 0 where there are none. What is computed of a frame is kept for
  // the next call, as its authors advise.
  std::optional<SE3> track(const Plane<float>& depth, const std::vector<std::uint8_t>& levels);

 private:
  double scale_;
  cv::Ptr<cv::rgbd::RgbdICPOdometry> odometry_;
  cv::Ptr<cv::rgbd::OdometryFrame> previous_;
};

}  // namespace gastronaut::slam

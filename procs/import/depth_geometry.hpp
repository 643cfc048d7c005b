// Depth pictures come on the pixels of the lens; depth_image_t has a pinhole's. Nearest neighbour:
// depths of two surfaces must not be mixed.
#pragma once

#include <cstdint>
#include <vector>

#include "camera/camera_model.hpp"

namespace gastronaut {

class DepthUndistorter {
 public:
  // The pinhole picture has the lens picture's size, focal lengths and principal point.
  explicit DepthUndistorter(const CameraIntrinsics& lens);

  // Counts row by row; 0, no depth, where the lens does not look. Depth along the optical axis is
  // the same number in both geometries.
  std::vector<std::uint16_t> undistort(const std::vector<std::uint16_t>& depth) const;

 private:
  static constexpr std::int32_t kOutside = -1;
  std::vector<std::int32_t> source_;  // index into the lens picture, for each pinhole pixel
};

}  // namespace gastronaut

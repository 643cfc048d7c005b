#include "import/depth_geometry.hpp"

#include <cmath>
#include <cstddef>

namespace gastronaut {

DepthUndistorter::DepthUndistorter(const CameraIntrinsics& lens) {
  const CameraModel model(lens);
  source_.reserve(static_cast<std::size_t>(lens.width) * static_cast<std::size_t>(lens.height));
  for (int v = 0; v < lens.height; ++v) {
    for (int u = 0; u < lens.width; ++u) {
      const auto pixel = model.project({(u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy, 1});
      const double column = pixel ? std::round(pixel->x()) : kOutside;
      const double row = pixel ? std::round(pixel->y()) : kOutside;
      const bool inside = column >= 0 && column < lens.width && row >= 0 && row < lens.height;
      source_.push_back(inside ? static_cast<std::int32_t>(row) * lens.width +
                                     static_cast<std::int32_t>(column)
                               : kOutside);
    }
  }
}

std::vector<std::uint16_t> DepthUndistorter::undistort(
    const std::vector<std::uint16_t>& depth) const {
  std::vector<std::uint16_t> pinhole(source_.size(), 0);
  for (std::size_t i = 0; i < source_.size(); ++i) {
    if (source_[i] != kOutside) pinhole[i] = depth[static_cast<std::size_t>(source_[i])];
  }
  return pinhole;
}

}  // namespace gastronaut

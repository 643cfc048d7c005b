#include "photometry/camera_response.hpp"

#include <algorithm>
#include <cmath>

namespace gastronaut {

std::array<float, 256> linear_light_of_levels(const CameraConfiguration& camera) {
  std::array<float, 256> light{};
  const double knots = static_cast<double>(camera.response.size()) - 1;
  for (std::size_t level = 0; level < light.size(); ++level) {
    const double fraction = static_cast<double>(level) / 255;
    if (camera.response.empty()) {
      light[level] = static_cast<float>(std::pow(fraction, camera.gamma));
      continue;
    }
    const double place = fraction * knots;
    const auto knot = std::min(static_cast<std::size_t>(place), camera.response.size() - 2);
    const double along = place - static_cast<double>(knot);
    light[level] =
        static_cast<float>((1 - along) * camera.response[knot] + along * camera.response[knot + 1]);
  }
  return light;
}

}  // namespace gastronaut

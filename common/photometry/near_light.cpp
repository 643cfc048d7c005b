#include "photometry/near_light.hpp"

#include <cmath>
#include <numbers>

namespace gastronaut {

NearLight::NearLight(const CameraConfiguration& camera, const LightsConfiguration& lights)
    : lobe_(lights.lobe),
      led_intensity_(camera.led_intensity),
      vignetting_cos_power_(camera.vignetting_cos_power) {
  for (int k = 0; k < lights.count; ++k) {
    const double angle = 2 * std::numbers::pi * k / lights.count + lights.phase;
    positions_.push_back(lights.radius * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0));
  }
}

Eigen::Vector3d NearLight::irradiance_vector(const Eigen::Vector3d& point) const {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& light : positions_) {
    const Eigen::Vector3d way = light - point;
    const double distance = way.norm();
    const double cosine = -way.z() / distance;
    if (cosine > 0) sum += std::pow(cosine, lobe_) / (distance * distance * distance) * way;
  }
  return led_intensity_ * sum;
}

double NearLight::vignetting(const Eigen::Vector3d& ray) const {
  return std::pow(ray.z() / ray.norm(), vignetting_cos_power_);
}

}  // namespace gastronaut

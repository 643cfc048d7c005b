// Light of LEDs beside the lens on tissue a few millimetres to centimetres away.
//
// A patch at P (camera frame, metres) with unit normal n towards the camera and Lambertian albedo
// rho is seen with the linear light
//   L = exposure * vignetting(ray) * rho * n . W(P),
//   W(P) = led_intensity * sum over lights at L_k of cos^lobe_k (L_k - P) / |L_k - P|^3,
// cos_k being that of the angle between the optical axis and the ray from light k to P: lights add
// up before the normal comes in, as long as the patch faces all of them. Inverse-square fall-off
// and Lambert's cosine are both in it. (Quéau et al. 2018, "LED-based photometric stereo".)
#pragma once

#include <Eigen/Core>
#include <vector>

#include "configuration/rig_configuration.hpp"

namespace gastronaut {

class NearLight {
 public:
  NearLight(const CameraConfiguration& camera, const LightsConfiguration& lights);

  // W(P), dimensionless; zero light from lights that P lies at or behind.
  Eigen::Vector3d irradiance_vector(const Eigen::Vector3d& point) const;
  // What the lens takes off towards the picture's border, 0 to 1; `ray` of any length.
  double vignetting(const Eigen::Vector3d& ray) const;

  // Lights in the camera frame, metres.
  const std::vector<Eigen::Vector3d>& positions() const { return positions_; }
  double lobe() const { return lobe_; }
  double led_intensity() const { return led_intensity_; }

 private:
  std::vector<Eigen::Vector3d> positions_;
  double lobe_;
  double led_intensity_;
  double vignetting_cos_power_;
};

}  // namespace gastronaut

// From linear light to what shape from shading is given, and back from its shape to the albedo.
#pragma once

#include <array>
#include <cstdint>

#include "configuration/rig_configuration.hpp"
#include "depth_estimator/front_end.hpp"
#include "depth_estimator/shape_from_shading.hpp"
#include "image/plane.hpp"

namespace gastronaut::perception {

class LightDivider {
 public:
  // `factor`: pixels of the picture to one of the grid, along each side.
  LightDivider(const RigConfiguration& configuration, const PinholeGrid& grid, int factor);

  // The picture's light per unit albedo and LED power on the grid, from red where that is not
  // saturated (blood and vessels darken it least), else from green, else from blue, each over its
  // mean albedo. `gain` multiplies camera.exposure_gain.
  void shade(const LinearPicture& picture, double gain, Shading& shading) const;

  // What a point looks like wherever the lamp is: its green light over what the shading model says
  // of unit albedo, darkened where there are vessels. 255 is an albedo of 1; 0 is no data
  // (highlight, saturated, outside).
  void divide(const LinearPicture& picture, double gain, const Plane<float>& log_shading,
              const Plane<float>& vessels, Plane<std::uint8_t>& albedo) const;

 private:
  double log_power(double gain) const;

  PinholeGrid grid_;
  int factor_;
  double power_;  // exposure_gain times led_intensity, square metres
  double noise_;  // of linear light, one sigma, in the dark
  double data_std_;
  std::array<double, 3> albedo_{};
  Plane<float> log_vignetting_;  // on the grid
};

}  // namespace gastronaut::perception

// A lamp, a lens and a flat card made from physics alone, and pictures of it as samples.
#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "calibrate/light_samples.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

struct SimulatedCard {
  Eigen::Vector3d normal = Eigen::Vector3d(0.2, -0.1, 1).normalized();  // rig frame, towards lens
  double height = -0.01;  // metres: points X of the card have normal . X = height
  double albedo = 0.9;
};

struct SimulatedPictures {
  int pictures = 24;
  double nearest = 0.008;  // metres from the lens to the card, along the optical axis
  double furthest = 0.05;
  double tilt = 0.35;  // tangent of how far the view leaves the card's normal, at most
  // Level (0..1) of linear light; none: light^(1/gamma).
  std::function<double(double)> response;
  bool noisy = true;
  // One sigma of the poses that are told: metres, radians.
  double position_std = 1e-4;
  double angle_std = 1e-3;
  bool poses_err = true;  // else the true ones are told
  std::uint64_t seed = 1;
};

// What `truth` (led_intensity, lobe, vignetting, gamma, noise, lens) sees of the card: 20 x 15
// samples a picture, those left out that are dark or saturated.
std::vector<LightPicture> simulate_pictures(const RigConfiguration& truth,
                                            const SimulatedCard& card, const SimulatedPictures& run,
                                            SampleCounts& counts);

}  // namespace gastronaut

// Smooth noise in three dimensions (Perlin, "Improving noise", SIGGRAPH 2002) with hashed
// gradients: a pure function of the point and the seed, no tables.
#pragma once

#include <Eigen/Core>
#include <cstdint>

namespace gastronaut {

struct NoiseSample {
  float value;  // mean 0, about -1..1, one sigma about 0.27
  Eigen::Vector3f gradient;
};

// Lattice of unit spacing: divide the point by the wavelength first.
NoiseSample gradient_noise(const Eigen::Vector3f& point, std::uint32_t seed);

}  // namespace gastronaut

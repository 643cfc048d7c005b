// What the wall looks like: albedo with slow variation, mottling and vessels, and the mucus on it.
// Painted on the wall at rest, so it moves with the wall.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "virtual_rig/organ.hpp"
#include "virtual_rig/vessel_network.hpp"

namespace gastronaut {

struct TissueSample {
  Eigen::Vector3f albedo;  // red, green, blue
  // Highlight of the mucus: film (exponent + 8) / 8 max(0, n.h)^exponent with h halfway between
  // light and eye, and n the wall's normal tilted by -ripple (Blinn and Phong).
  float film;
  float exponent;
  Eigen::Vector3f ripple;
};

class Tissue {
 public:
  Tissue(const OrganConfiguration& organ, const TriangleMesh& rest);

  // At a point of triangle `corners`: barycentric weights of its corners, and the point itself on
  // the wall at rest.
  TissueSample sample(const Triangle& corners, const std::array<float, 3>& weights,
                      const Eigen::Vector3f& rest_point) const;

 private:
  // What varies slowly enough to be kept one a vertex.
  struct Slow {
    float brightness;  // factor
    float redness;     // relative: what green and blue lose
    float film;
    float exponent;
  };

  OrganConfiguration organ_;
  std::vector<Slow> slow_;
  VesselNetwork vessels_;
};

}  // namespace gastronaut

// Drawn numbers and poses for tests, the same in every run.
#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "geometry/se3.hpp"
#include "numerics/counter_random.hpp"

namespace gastronaut::evaluation {

class Draws {
 public:
  explicit Draws(std::uint64_t seed) : random_(seed, 0) {}

  double normal() { return random_.normal(index_++); }
  Eigen::Vector3d vector(double sigma) {
    const double x = normal();
    const double y = normal();
    return sigma * Eigen::Vector3d(x, y, normal());
  }
  Eigen::Quaterniond rotation() { return so3_exp(vector(1)); }

 private:
  CounterRandom random_;
  std::uint64_t index_ = 0;
};

}  // namespace gastronaut::evaluation

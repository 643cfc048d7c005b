// One robust loss for all fits here: quadratic up to kRobustKnee sigmas, logarithmic beyond, so
// that a reading that is wrong by far pulls less the further off it is.
#pragma once

#include <cmath>

namespace gastronaut {

constexpr double kRobustKnee = 4;  // sigmas: one good reading in 16 000 lies beyond

// Loss of a residual given in sigmas, and its weight: d(loss)/d(residual) = 2 weight * residual.
inline double robust_loss(double residual) {
  const double excess = std::abs(residual) / kRobustKnee;
  return excess <= 1 ? residual * residual : kRobustKnee * kRobustKnee * (1 + 2 * std::log(excess));
}
inline double robust_weight(double residual) {
  const double excess = std::abs(residual) / kRobustKnee;
  return excess <= 1 ? 1 : 1 / (excess * excess);
}

}  // namespace gastronaut

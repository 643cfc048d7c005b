// What one history of sensor failures makes of the capsule where one Gaussian cannot say it: a sum
// of weighted ones (Alspach and Sorenson 1972). There are many as long as the roll about the
// magnet's axis is open, and one afterwards.
#pragma once

#include <cstddef>
#include <functional>
#include <vector>

#include "sensor_fusion/capsule_belief.hpp"

namespace gastronaut::fusion {

// What a measurement does to a mixture, a Gain a belief.
struct MixtureGain {
  std::vector<Gain> gains;
  double log_density = 0;  // of the measurement under the whole mixture
};

struct BeliefMixture {
  std::vector<CapsuleBelief> beliefs;
  std::vector<double> weights;  // sum 1

  explicit BeliefMixture(const CapsuleBelief& belief) : beliefs{belief}, weights{1} {}
  // `count` hypotheses about the roll about the magnet's axis, all of it in even steps.
  static BeliefMixture of_all_rolls(const CapsuleBelief& belief, int count);

  MixtureGain weigh(const std::function<Innovation(const CapsuleBelief&)>& observe) const;
  // Beliefs that have become impossible are left out.
  void update(const MixtureGain& gain);
  std::size_t likeliest() const;
};

}  // namespace gastronaut::fusion

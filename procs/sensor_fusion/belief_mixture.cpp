#include "sensor_fusion/belief_mixture.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

namespace gastronaut::fusion {
namespace {

constexpr double kLeastWeight = 1e-6;

}  // namespace

BeliefMixture BeliefMixture::of_all_rolls(const CapsuleBelief& belief, int count) {
  const double step = 2 * std::numbers::pi / count;
  BeliefMixture mixture(belief);
  mixture.beliefs.clear();
  // Neighbours meet at two sigmas.
  for (int i = 0; i < count; ++i) {
    mixture.beliefs.push_back(belief.rolled(i * step, step * step / 4));
  }
  mixture.weights.assign(mixture.beliefs.size(), 1.0 / count);
  return mixture;
}

MixtureGain BeliefMixture::weigh(
    const std::function<Innovation(const CapsuleBelief&)>& observe) const {
  MixtureGain result;
  double largest = -std::numeric_limits<double>::infinity();
  for (const CapsuleBelief& belief : beliefs) {
    result.gains.push_back(belief.weigh(observe(belief)));
    Gain& gain = result.gains.back();
    if (!std::isfinite(gain.log_density)) {
      gain.log_density = -std::numeric_limits<double>::infinity();
    }
    largest = std::max(largest, gain.log_density);
  }
  result.log_density = largest;
  if (!std::isfinite(largest)) return result;
  double sum = 0;
  for (std::size_t i = 0; i < beliefs.size(); ++i) {
    sum += weights[i] * std::exp(result.gains[i].log_density - largest);
  }
  result.log_density += std::log(sum);
  return result;
}

void BeliefMixture::update(const MixtureGain& gain) {
  std::vector<CapsuleBelief> kept;
  std::vector<double> kept_weights;
  double sum = 0;
  for (std::size_t i = 0; i < beliefs.size(); ++i) {
    const double weight = weights[i] * std::exp(gain.gains[i].log_density - gain.log_density);
    if (!(weight > kLeastWeight)) continue;
    beliefs[i].update(gain.gains[i]);
    kept.push_back(std::move(beliefs[i]));
    kept_weights.push_back(weight);
    sum += weight;
  }
  if (kept.empty()) return;
  beliefs = std::move(kept);
  weights = std::move(kept_weights);
  for (double& weight : weights) weight /= sum;
}

std::size_t BeliefMixture::likeliest() const {
  return static_cast<std::size_t>(std::max_element(weights.begin(), weights.end()) -
                                  weights.begin());
}

}  // namespace gastronaut::fusion

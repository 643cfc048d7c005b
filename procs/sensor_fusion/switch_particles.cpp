#include "sensor_fusion/switch_particles.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "numerics/counter_random.hpp"

namespace gastronaut::fusion {
namespace {

// A confidence of zero would never come back (reference-facts.md, section 4).
constexpr double kLeastConfidence = 1e-3;
constexpr std::uint64_t kStreamsPerStep = 4;

}  // namespace

SwitchParticles::SwitchParticles(std::size_t count, double memory, std::uint64_t seed,
                                 double confidence)
    : memory_(memory), seed_(seed) {
  if (count < 1 || !(memory > 0) || !(confidence > 0) || !(confidence < 1)) {
    throw std::invalid_argument(
        "sensor_fusion: there must be particles, a memory above zero, confidence within (0, 1)");
  }
  belief_.assign(count, 0);
  is_nominal_.assign(count, 1);
  weight_.assign(count, 1 / static_cast<double>(count));
  for (std::vector<double>& alpha : alpha_) alpha.assign(count, confidence);
  nominal_.resize(count);
}

void SwitchParticles::spread(std::size_t beliefs) {
  for (std::size_t i = 0; i < size(); ++i) belief_[i] = static_cast<int>(i * beliefs / size());
  std::fill(weight_.begin(), weight_.end(), 1 / static_cast<double>(size()));
}

double SwitchParticles::update(std::size_t sensor,
                               const std::vector<SwitchLikelihood>& likelihoods) {
  // Densities are only known up to a common factor: the largest becomes one.
  double largest = -std::numeric_limits<double>::infinity();
  for (const SwitchLikelihood& likelihood : likelihoods) {
    largest = std::max({largest, likelihood.log_nominal, likelihood.log_failed});
  }
  std::vector<double> nominal_density;
  std::vector<double> failed_density;
  for (const SwitchLikelihood& likelihood : likelihoods) {
    nominal_density.push_back(std::exp(likelihood.log_nominal - largest));
    failed_density.push_back(std::exp(likelihood.log_failed - largest));
  }
  std::vector<double>& alpha = alpha_[sensor];
  const std::vector<double> before = weight_;
  double sum = 0;
  double nominal_sum = 0;
  for (std::size_t i = 0; i < size(); ++i) {
    const auto belief = static_cast<std::size_t>(belief_[i]);
    const double nominal = alpha[i] * nominal_density[belief];
    const double evidence = nominal + (1 - alpha[i]) * failed_density[belief];
    nominal_[i] = evidence > 0 ? nominal / evidence : 0.5;
    nominal_sum += weight_[i] * nominal;
    weight_[i] *= evidence;
    sum += weight_[i];
  }
  // Every history that particles still hold is out of the question compared with one that none
  // holds: a measurement for nobody. All histories stay as likely as they are.
  const bool lost = !(sum > 0) || !std::isfinite(sum);
  if (lost) std::fill(nominal_.begin(), nominal_.end(), 0.0);
  const double posterior = lost ? 0 : nominal_sum / sum;
  for (std::size_t i = 0; i < size(); ++i) weight_[i] = lost ? before[i] : weight_[i] / sum;

  const CounterRandom uniforms(seed_, kStreamsPerStep * step_);
  for (std::size_t i = 0; i < size(); ++i) {
    const bool nominal = uniforms.uniform(i) < nominal_[i];
    is_nominal_[i] = nominal ? 1 : 0;
    // Dirichlet over (nominal, failed) with the sampled switch counted in.
    const double drawn = sample_beta(memory_ * alpha[i] + (nominal ? 1 : 0),
                                     memory_ * (1 - alpha[i]) + (nominal ? 0 : 1), i);
    alpha[i] = std::clamp(drawn, kLeastConfidence, 1 - kLeastConfidence);
  }
  ++step_;
  return posterior;
}

void SwitchParticles::renumber(const std::vector<int>& number) {
  double kept = 0;
  for (std::size_t i = 0; i < size(); ++i) {
    const auto history = static_cast<std::size_t>(2 * belief_[i] + is_nominal_[i]);
    const int belief = number[history];
    if (belief < 0) weight_[i] = 0;
    belief_[i] = std::max(belief, 0);
    kept += weight_[i];
  }
  if (!(kept > 0)) throw std::invalid_argument("sensor_fusion: no history of failures is left");
  for (double& weight : weight_) weight /= kept;
}

void SwitchParticles::resample() {
  double squares = 0;
  for (const double weight : weight_) squares += weight * weight;
  const double count = static_cast<double>(size());
  if (1 / squares >= count / 2) return;
  const double offset = CounterRandom(seed_, kStreamsPerStep * step_ + 3).uniform(0);
  std::vector<std::size_t> source(size());
  double sum = weight_[0];
  std::size_t from = 0;
  for (std::size_t i = 0; i < size(); ++i) {
    const double place = (static_cast<double>(i) + offset) / count;
    while (sum < place && from + 1 < size()) sum += weight_[++from];
    source[i] = from;
  }
  const auto gather = [&source](auto& values) {
    auto copy = values;
    for (std::size_t i = 0; i < copy.size(); ++i) values[i] = copy[source[i]];
  };
  gather(belief_);
  gather(is_nominal_);
  for (std::vector<double>& alpha : alpha_) gather(alpha);
  std::fill(weight_.begin(), weight_.end(), 1 / count);
}

std::vector<double> SwitchParticles::history_weights(std::size_t beliefs) const {
  std::vector<double> sums(2 * beliefs, 0);
  for (std::size_t i = 0; i < size(); ++i) {
    sums[static_cast<std::size_t>(2 * belief_[i] + is_nominal_[i])] += weight_[i];
  }
  return sums;
}

std::vector<double> SwitchParticles::belief_weights(std::size_t beliefs) const {
  std::vector<double> sums(beliefs, 0);
  for (std::size_t i = 0; i < size(); ++i) sums[static_cast<std::size_t>(belief_[i])] += weight_[i];
  return sums;
}

double SwitchParticles::confidence(std::size_t sensor) const {
  double mean = 0;
  for (std::size_t i = 0; i < size(); ++i) mean += weight_[i] * alpha_[sensor][i];
  return mean;
}

double SwitchParticles::sample_beta(double a, double b, std::uint64_t particle) {
  // A stretch of the stream a particle: a rejected draw takes the next number of its own.
  constexpr std::uint64_t kStretch = 1 << 10;
  std::uint64_t index = particle * kStretch;
  const double x = sample_gamma(a, kStreamsPerStep * step_ + 1, index);
  index = particle * kStretch;
  const double y = sample_gamma(b, kStreamsPerStep * step_ + 2, index);
  return x + y > 0 ? x / (x + y) : 0.5;
}

// Marsaglia and Tsang, "A simple method for generating gamma variables", 2000.
double SwitchParticles::sample_gamma(double shape, std::uint64_t stream, std::uint64_t& index) {
  const CounterRandom random(seed_, stream);
  if (shape < 1) {
    const double boost = std::pow(random.uniform(index++), 1 / shape);
    return boost * sample_gamma(shape + 1, stream, index);
  }
  const double d = shape - 1.0 / 3;
  const double c = 1 / std::sqrt(9 * d);
  for (;;) {
    const double x = random.normal(index++);
    const double v = 1 + c * x;
    if (v <= 0) continue;
    const double cube = v * v * v;
    const double u = random.uniform(index++);
    if (std::log(u) < 0.5 * x * x + d - d * cube + d * std::log(cube)) return d * cube;
  }
}

}  // namespace gastronaut::fusion

// Particles over what cannot be filtered in closed form: which history of sensor failures is the
// true one, and how far each sensor can be trusted (Caron, Davy, Duflos, Vanheeghe 2007).
//
// Per sensor k the switch s_k is 1 (nominal) with probability alpha_k, and alpha_k, the confidence,
// evolves as a Dirichlet walk with memory sigma: alpha_t ~ Dirichlet(sigma * alpha_{t-1}). A
// particle holds the confidences and the number of the Gaussian belief that its own history of
// switches leads to; particles of one history share one belief.
//
// Structure of arrays. Random numbers are counter-based: the same calls give the same particles.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace gastronaut::fusion {

inline constexpr std::size_t kNumSensors = 2;

// Densities of one measurement under a belief: of a nominal sensor and of a failed one.
struct SwitchLikelihood {
  double log_nominal = 0;
  double log_failed = 0;
};

class SwitchParticles {
 public:
  // `count` particles, spread evenly over `beliefs`, confidences as the arguments say. Throws
  // std::invalid_argument for a count, memory or confidence that makes no sense.
  SwitchParticles(std::size_t count, double memory, std::uint64_t seed, double confidence);

  void spread(std::size_t beliefs);

  // One measurement of `sensor`: weighs the particles by it, samples switches and confidences from
  // their exact conditional distributions. `likelihoods`: one a belief. Afterwards particle i's
  // history is (belief()[i], is_nominal()[i]). Returns the posterior probability that the switch is
  // nominal.
  double update(std::size_t sensor, const std::vector<SwitchLikelihood>& likelihoods);
  // Particle i belongs to belief `number[2 * belief()[i] + is_nominal()[i]]` from now on; -1: that
  // history is given up, and the particle with it. Throws std::invalid_argument when none is left.
  void renumber(const std::vector<int>& number);
  // Systematic resampling where the effective number of particles is below half.
  void resample();

  // Sum of the weights of each (belief, switch), as renumber counts them.
  std::vector<double> history_weights(std::size_t beliefs) const;
  // Of each belief.
  std::vector<double> belief_weights(std::size_t beliefs) const;
  // Minimum mean square error estimate of alpha.
  double confidence(std::size_t sensor) const;

  std::size_t size() const { return weight_.size(); }
  const std::vector<int>& belief() const { return belief_; }
  const std::vector<std::uint8_t>& is_nominal() const { return is_nominal_; }
  const std::vector<double>& weight() const { return weight_; }
  const std::vector<double>& confidences(std::size_t sensor) const { return alpha_[sensor]; }

 private:
  double sample_beta(double a, double b, std::uint64_t particle);
  double sample_gamma(double shape, std::uint64_t stream, std::uint64_t& index);

  double memory_;
  std::uint64_t seed_;
  std::uint64_t step_ = 0;  // draws so far: the stream of the next ones
  std::vector<int> belief_;
  std::vector<std::uint8_t> is_nominal_;
  std::vector<double> weight_;  // sum 1
  std::array<std::vector<double>, kNumSensors> alpha_;
  std::vector<double> nominal_;  // workspace: probability of the nominal switch
};

}  // namespace gastronaut::fusion

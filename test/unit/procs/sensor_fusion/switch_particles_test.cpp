#include "sensor_fusion/switch_particles.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>

namespace gastronaut::fusion {
namespace {

constexpr double kRounding = 1e-12;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kSigmas = 5;  // of Monte-Carlo error

void expect_sound(const SwitchParticles& particles) {
  double sum = 0;
  for (const double weight : particles.weight()) {
    ASSERT_TRUE(std::isfinite(weight) && weight >= 0);
    sum += weight;
  }
  EXPECT_NEAR(sum, 1, 1e-9);
  for (std::size_t sensor = 0; sensor < kNumSensors; ++sensor) {
    EXPECT_TRUE(std::isfinite(particles.confidence(sensor)));
  }
}

TEST(SwitchParticles, FirstPosteriorIsBayes) {
  constexpr double kConfidence = 0.8;
  SwitchParticles particles(100, 50, 1, kConfidence);
  const double nominal = std::exp(-3.0);
  const double failed = std::exp(-1.5);
  const double expected =
      kConfidence * nominal / (kConfidence * nominal + (1 - kConfidence) * failed);
  EXPECT_NEAR(particles.update(0, {{-3.0, -1.5}}), expected, kRounding);
}

TEST(SwitchParticles, BeliefsAreWeighedByTheirEvidence) {
  constexpr double kConfidence = 0.7;
  SwitchParticles particles(300, 50, 1, kConfidence);
  particles.spread(3);
  const std::vector<SwitchLikelihood> likelihoods = {{-1, -4}, {-2, -3}, {-30, -4}};
  particles.update(1, likelihoods);
  std::vector<double> expected;
  for (const SwitchLikelihood& l : likelihoods) {
    expected.push_back(kConfidence * std::exp(l.log_nominal) +
                       (1 - kConfidence) * std::exp(l.log_failed));
  }
  const double sum = std::accumulate(expected.begin(), expected.end(), 0.0);
  const std::vector<double> weights = particles.belief_weights(3);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(weights[i], expected[i] / sum, kRounding);
}

TEST(SwitchParticles, ConfidenceFollowsTheSensor) {
  SwitchParticles particles(1000, 50, 1, 0.5);
  const auto feed = [&](double log_nominal, double log_failed) {
    for (int i = 0; i < 1000; ++i) {
      particles.update(0, {{log_nominal, log_failed}});
      particles.renumber({0, 0});
      particles.resample();
    }
  };
  feed(0, -20);
  EXPECT_GT(particles.confidence(0), 0.95);
  EXPECT_EQ(particles.confidence(1), 0.5);
  feed(-20, 0);
  EXPECT_LT(particles.confidence(0), 0.05);
  constexpr double kFloor = 1e-3;  // never out of reach (reference-facts.md, section 4)
  for (const double alpha : particles.confidences(0)) EXPECT_GE(alpha, kFloor);
  feed(0, -20);
  EXPECT_GT(particles.confidence(0), 0.95);
}

// alpha' ~ Beta(memory * alpha + 1, memory * (1 - alpha)) after a nominal measurement.
TEST(SwitchParticles, ConfidencesHaveTheMomentsOfTheDirichletWalk) {
  constexpr std::size_t kCount = 40'000;
  for (const double memory : {2.0, 10.0, 100.0}) {
    for (const bool nominal : {true, false}) {
      constexpr double kConfidence = 0.6;
      SwitchParticles particles(kCount, memory, 7, kConfidence);
      particles.update(0, {{nominal ? 0.0 : -kInfinity, nominal ? -kInfinity : 0.0}});
      const double a = memory * kConfidence + (nominal ? 1 : 0);
      const double b = memory * (1 - kConfidence) + (nominal ? 0 : 1);
      const double mean = a / (a + b);
      const double variance = a * b / ((a + b) * (a + b) * (a + b + 1));
      double sum = 0;
      double squares = 0;
      for (const double alpha : particles.confidences(0)) {
        sum += alpha;
        squares += (alpha - mean) * (alpha - mean);
      }
      const double count = static_cast<double>(kCount);
      EXPECT_NEAR(sum / count, mean, kSigmas * std::sqrt(variance / count));
      // A bounded variable's fourth moment is below a few squared variances.
      EXPECT_NEAR(squares / count, variance, kSigmas * variance * std::sqrt(3 / count));
    }
  }
}

TEST(SwitchParticles, ResamplingKeepsTheHistoriesWeights) {
  constexpr std::size_t kCount = 1000;
  SwitchParticles particles(kCount, 50, 3, 0.5);
  particles.spread(4);
  particles.update(0, {{0, -1}, {-3, -2}, {-4, -9}, {-2, -5}});
  const std::vector<double> before = particles.belief_weights(4);
  particles.resample();
  EXPECT_EQ(particles.weight().front(), particles.weight().back());  // it did resample
  const std::vector<double> after = particles.belief_weights(4);
  // Systematic: a contiguous group gets its share to within one particle.
  for (std::size_t i = 0; i < 4; ++i) EXPECT_NEAR(after[i], before[i], 1.0 / kCount + kRounding);
  expect_sound(particles);
}

TEST(SwitchParticles, EvenWeightsAreNotResampled) {
  SwitchParticles particles(10, 50, 3, 0.5);
  particles.spread(10);
  const std::vector<int> before = particles.belief();
  particles.resample();
  EXPECT_EQ(particles.belief(), before);
}

TEST(SwitchParticles, RenumberDropsHistoriesGivenUp) {
  SwitchParticles particles(1000, 50, 3, 0.5);
  particles.spread(2);
  particles.update(0, {{0, 0}, {0, 0}});
  const std::vector<double> histories = particles.history_weights(2);
  // Belief 0 failed and belief 1 nominal stay.
  particles.renumber({1, -1, -1, 0});
  const std::vector<double> weights = particles.belief_weights(2);
  const double kept = histories[0] + histories[3];
  EXPECT_NEAR(weights[0], histories[3] / kept, kRounding);
  EXPECT_NEAR(weights[1], histories[0] / kept, kRounding);
  expect_sound(particles);
}

TEST(SwitchParticles, SameCallsSameBytesOtherSeedOtherNumbers) {
  const auto confidences = [](std::uint64_t seed) {
    SwitchParticles particles(100, 50, seed, 0.5);
    for (int i = 0; i < 20; ++i) {
      particles.update(static_cast<std::size_t>(i) % 2, {{-1.0 * (i % 3), -1}});
      particles.renumber({0, 0});
      particles.resample();
    }
    return particles.confidences(0);
  };
  EXPECT_EQ(confidences(1), confidences(1));
  EXPECT_NE(confidences(1), confidences(2));
}

TEST(SwitchParticles, DegenerateLikelihoodsLeaveTheWeightsSound) {
  const std::vector<SwitchLikelihood> degenerate[] = {
      {{-kInfinity, -kInfinity}, {-kInfinity, -kInfinity}},
      {{kNaN, kNaN}, {kNaN, kNaN}},
      {{kNaN, 0}, {0, 0}},
      {{0, 0}, {0, kNaN}},
      {{-kInfinity, 0}, {0, -kInfinity}},
      {{kInfinity, 0}, {0, 0}},
      {{-1e300, -1e300}, {-1e308, -1e308}},
  };
  for (const auto& likelihoods : degenerate) {
    SwitchParticles particles(100, 50, 1, 0.5);
    particles.spread(2);
    const double posterior = particles.update(0, likelihoods);
    EXPECT_TRUE(posterior >= 0 && posterior <= 1);
    expect_sound(particles);
    particles.resample();
    expect_sound(particles);
  }
}

TEST(SwitchParticles, ArgumentsThatMakeNoSenseAreRefused) {
  EXPECT_THROW(SwitchParticles(0, 50, 1, 0.5), std::invalid_argument);
  EXPECT_THROW(SwitchParticles(10, 0, 1, 0.5), std::invalid_argument);
  EXPECT_THROW(SwitchParticles(10, kNaN, 1, 0.5), std::invalid_argument);
  EXPECT_THROW(SwitchParticles(10, 50, 1, 1), std::invalid_argument);
}

}  // namespace
}  // namespace gastronaut::fusion

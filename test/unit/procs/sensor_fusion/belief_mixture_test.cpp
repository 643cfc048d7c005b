#include "sensor_fusion/belief_mixture.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

namespace gastronaut::fusion {
namespace {

constexpr int kRolls = 24;
constexpr double kRounding = 1e-12;

CapsuleBelief some_belief() {
  CapsuleBelief belief;
  belief.magnet_position = {5e-4, -3e-4, -9e-3};
  belief.magnet_axis = Eigen::Vector3d(0.1, -0.05, 1).normalized();
  belief.rig_R_camera = so3_exp({1, 0.5, -0.3});
  belief.position = {0.01, 0.02, 0.06};
  belief.covariance.diagonal().setConstant(1e-6);
  return belief;
}

MagneticFix fix_of(const CapsuleBelief& belief) {
  MagneticFix fix;
  fix.position = belief.position;
  fix.axis = belief.axis_in_rig();
  fix.covariance = 1e-6 * Matrix5d::Identity();
  return fix;
}

double sum(const std::vector<double>& values) {
  return std::accumulate(values.begin(), values.end(), 0.0);
}

TEST(BeliefMixture, RollsCoverTheCircleAndLeaveTheMagnetWhereItIs) {
  const CapsuleBelief belief = some_belief();
  const BeliefMixture mixture = BeliefMixture::of_all_rolls(belief, kRolls);
  ASSERT_EQ(mixture.beliefs.size(), static_cast<std::size_t>(kRolls));
  EXPECT_NEAR(sum(mixture.weights), 1, kRounding);
  for (int i = 0; i < kRolls; ++i) {
    const CapsuleBelief& rolled = mixture.beliefs[static_cast<std::size_t>(i)];
    EXPECT_LT((rolled.position - belief.position).norm(), kRounding);
    EXPECT_LT((rolled.axis_in_rig() - belief.axis_in_rig()).norm(), kRounding);
    const double angle = 2 * std::numbers::pi * i / kRolls;
    EXPECT_NEAR(angle_between(rolled.rig_R_camera, belief.rig_R_camera),
                std::min(angle, 2 * std::numbers::pi - angle), 1e-7);  // square root of rounding
  }
}

// A magnet does not tell its roll: no fix may prefer one.
TEST(BeliefMixture, AFixTellsNothingOfTheRoll) {
  const CapsuleBelief belief = some_belief();
  BeliefMixture mixture = BeliefMixture::of_all_rolls(belief, kRolls);
  MagneticFix fix = fix_of(belief);
  fix.position.x() += 1e-3;
  fix.axis = so3_exp({2e-3, 1e-3, -1e-3}) * fix.axis;
  mixture.update(
      mixture.weigh([&](const CapsuleBelief& one) { return one.observe_magnet(fix, 1, true); }));
  ASSERT_EQ(mixture.beliefs.size(), static_cast<std::size_t>(kRolls));
  for (const double weight : mixture.weights) EXPECT_NEAR(weight, 1.0 / kRolls, 1e-9);
}

// Bayes: prior weights times densities.
TEST(BeliefMixture, WeightsFollowTheDensities) {
  const CapsuleBelief belief = some_belief();
  BeliefMixture mixture(belief);
  CapsuleBelief other = belief;
  other.position.x() += 1e-3;
  mixture.beliefs.push_back(other);
  mixture.weights = {0.25, 0.75};
  const MagneticFix fix = fix_of(belief);
  const auto observe = [&](const CapsuleBelief& one) { return one.observe_magnet(fix, 1, true); };
  const double here = 0.25 * std::exp(belief.weigh(observe(belief)).log_density);
  const double there = 0.75 * std::exp(other.weigh(observe(other)).log_density);
  const MixtureGain gain = mixture.weigh(observe);
  EXPECT_NEAR(gain.log_density, std::log(here + there), 1e-9);
  mixture.update(gain);
  ASSERT_EQ(mixture.weights.size(), 2U);
  EXPECT_NEAR(mixture.weights[0], here / (here + there), 1e-9);
  EXPECT_EQ(mixture.likeliest(), mixture.weights[0] > mixture.weights[1] ? 0U : 1U);
}

TEST(BeliefMixture, WhatHasBecomeImpossibleIsLeftOut) {
  const CapsuleBelief belief = some_belief();
  BeliefMixture mixture(belief);
  mixture.beliefs.push_back(belief);
  mixture.beliefs.back().position.x() += 0.1;  // a hundred sigmas
  mixture.weights = {0.5, 0.5};
  const MagneticFix fix = fix_of(belief);
  mixture.update(
      mixture.weigh([&](const CapsuleBelief& one) { return one.observe_magnet(fix, 1, true); }));
  ASSERT_EQ(mixture.beliefs.size(), 1U);
  EXPECT_EQ(mixture.weights[0], 1);
}

// A measurement that nobody can explain decides nothing.
TEST(BeliefMixture, IsNotLostToAMeasurementOfNumbersThatAreNone) {
  const CapsuleBelief belief = some_belief();
  BeliefMixture mixture = BeliefMixture::of_all_rolls(belief, kRolls);
  MagneticFix fix = fix_of(belief);
  fix.position.x() = std::numeric_limits<double>::quiet_NaN();
  const MixtureGain gain =
      mixture.weigh([&](const CapsuleBelief& one) { return one.observe_magnet(fix, 1, true); });
  EXPECT_EQ(gain.log_density, -std::numeric_limits<double>::infinity());
  mixture.update(gain);
  EXPECT_EQ(mixture.beliefs.size(), static_cast<std::size_t>(kRolls));
  EXPECT_NEAR(sum(mixture.weights), 1, kRounding);
}

}  // namespace
}  // namespace gastronaut::fusion

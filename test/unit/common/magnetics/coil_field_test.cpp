#include "magnetics/coil_field.hpp"

#include <gtest/gtest.h>

namespace gastronaut {
namespace {

constexpr double kMaxGap = 0.1;           // seconds
constexpr std::int64_t kPeriod = 10'000;  // microseconds
constexpr double kRounding = 1e-12;

const Eigen::Vector2d kFirst(1, -2);
const Eigen::Vector2d kSecond(3, 4);

CurrentHistory two_samples(std::int64_t apart) {
  CurrentHistory history(kMaxGap);
  history.add(0, kFirst);
  history.add(apart, kSecond);
  return history;
}

TEST(CoilField, IsTheMatrixTimesTheCurrents) {
  Eigen::MatrixXd matrix(3, 2);
  matrix << 1, 2, 3, 4, 5, 6;
  const CoilField coils(matrix);
  EXPECT_EQ(coils.num_channels(), 3);
  EXPECT_EQ(coils.num_coils(), 2);
  EXPECT_EQ(coils.field(Eigen::Vector2d(1, -1)), Eigen::Vector3d(-1, -1, -1));
}

TEST(CurrentHistory, InterpolatesBetweenSamples) {
  const CurrentHistory history = two_samples(kPeriod);
  EXPECT_EQ(history.at(0), kFirst);
  EXPECT_EQ(history.at(kPeriod), kSecond);
  const auto between = history.at(kPeriod / 4);
  ASSERT_TRUE(between);
  EXPECT_LT((*between - (0.75 * kFirst + 0.25 * kSecond)).norm(), kRounding);
}

TEST(CurrentHistory, HoldsTheNearestSampleJustOutside) {
  const CurrentHistory history = two_samples(kPeriod);
  EXPECT_EQ(history.at(-kPeriod), kFirst);
  EXPECT_EQ(history.at(2 * kPeriod), kSecond);
  EXPECT_EQ(history.newest(), kPeriod);
}

TEST(CurrentHistory, BridgesNoGapLongerThanAllowed) {
  constexpr std::int64_t kTooLong = 100'001;
  const CurrentHistory history = two_samples(kTooLong);
  EXPECT_FALSE(history.at(kTooLong / 2));
  EXPECT_TRUE(history.at(0));
  EXPECT_FALSE(history.at(2 * kTooLong));
  EXPECT_FALSE(history.at(-kTooLong));
}

TEST(CurrentHistory, KnowsNothingBeforeTheFirstSampleAndIgnoresOldOnes) {
  CurrentHistory history(kMaxGap);
  EXPECT_FALSE(history.newest());
  EXPECT_FALSE(history.at(0));
  history.add(kPeriod, kFirst);
  history.add(kPeriod, kSecond);
  history.add(0, kSecond);
  EXPECT_EQ(history.at(kPeriod), kFirst);
  EXPECT_EQ(history.at(0), kFirst);
}

}  // namespace
}  // namespace gastronaut

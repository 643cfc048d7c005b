#include "numerics/counter_random.hpp"

#include <gtest/gtest.h>

#include <cmath>

namespace gastronaut {
namespace {

using Block = std::array<std::uint32_t, 4>;

// Known answers published with Random123 (kat_vectors, philox4x32 10).
TEST(Philox, GivesThePublishedAnswers) {
  EXPECT_EQ(philox({0, 0, 0, 0}, {0, 0}), (Block{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  EXPECT_EQ(philox({0xffffffff, 0xffffffff, 0xffffffff, 0xffffffff}, {0xffffffff, 0xffffffff}),
            (Block{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}),
            (Block{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(CounterRandom, NumberDependsOnlyOnSeedStreamAndIndex) {
  const CounterRandom a(1, 2);
  const double later = a.uniform(1000);
  a.uniform(0);
  EXPECT_EQ(CounterRandom(1, 2).uniform(1000), later);
  EXPECT_NE(CounterRandom(1, 3).uniform(1000), later);
  EXPECT_NE(CounterRandom(2, 2).uniform(1000), later);
}

TEST(CounterRandom, NormalHasTheMomentsOfANormal) {
  constexpr int kCount = 200000;
  const CounterRandom random(42, 0);
  double sum = 0;
  double sum_squares = 0;
  double sum_fourth = 0;
  for (std::uint64_t i = 0; i < kCount; ++i) {
    const double x = random.normal(i);
    sum += x;
    sum_squares += x * x;
    sum_fourth += x * x * x * x;
  }
  // Five standard errors of each moment: 1, sqrt(2) and sqrt(96) over sqrt(n).
  const double five_over_root = 5 / std::sqrt(double{kCount});
  EXPECT_NEAR(sum / kCount, 0, five_over_root);
  EXPECT_NEAR(sum_squares / kCount, 1, five_over_root * std::sqrt(2.0));
  EXPECT_NEAR(sum_fourth / kCount, 3, five_over_root * std::sqrt(96.0));
}

TEST(CounterRandom, UniformFillsTheOpenInterval) {
  constexpr int kCount = 100000;
  const CounterRandom random(42, 1);
  double sum = 0;
  for (std::uint64_t i = 0; i < kCount; ++i) {
    const double x = random.uniform(i);
    ASSERT_GT(x, 0);
    ASSERT_LT(x, 1);
    sum += x;
  }
  EXPECT_NEAR(sum / kCount, 0.5, 5 / std::sqrt(12.0 * kCount));
}

}  // namespace
}  // namespace gastronaut

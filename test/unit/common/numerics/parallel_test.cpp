#include "numerics/parallel.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

namespace gastronaut {
namespace {

double harmonic_sum(int threads) {
  set_thread_count(threads);
  constexpr std::size_t kTerms = 100001;
  constexpr std::size_t kChunk = 64;
  const double sum = parallel_reduce_in_order(
      kTerms, kChunk, 0.0,
      [](std::size_t begin, std::size_t end) {
        double partial = 0;
        for (std::size_t i = begin; i < end; ++i) partial += 1.0 / static_cast<double>(i + 1);
        return partial;
      },
      std::plus<>());
  set_thread_count(0);
  return sum;
}

TEST(Parallel, SumIsTheSameToTheLastBitWhateverTheThreads) {
  const double one = harmonic_sum(1);
  for (int repetition = 0; repetition < 20; ++repetition) {
    EXPECT_EQ(harmonic_sum(2), one);
    EXPECT_EQ(harmonic_sum(4), one);
  }
  // Euler and Mascheroni: H_n = ln n + gamma + 1/(2n) - ...
  constexpr double kEulerGamma = 0.57721566490153286;
  EXPECT_NEAR(one, std::log(100001.0) + kEulerGamma + 0.5 / 100001.0, 1e-10);
}

TEST(Parallel, EveryIndexIsVisitedOnce) {
  std::vector<int> visits(1000, 0);
  parallel_for_chunks(visits.size(), 7, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) ++visits[i];
  });
  for (const int count : visits) EXPECT_EQ(count, 1);
}

TEST(Parallel, NothingToDoCallsNothing) {
  bool called = false;
  parallel_for_chunks(0, 8, [&](std::size_t, std::size_t) { called = true; });
  EXPECT_FALSE(called);
}

}  // namespace
}  // namespace gastronaut

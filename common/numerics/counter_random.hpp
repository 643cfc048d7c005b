// Counter-based random numbers: number n of stream s under a seed is a pure function of
// (seed, s, n), so the numbers are the same whatever thread draws them and in whatever order.
// Philox 4x32-10 of Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
#pragma once

#include <array>
#include <cstdint>

namespace gastronaut {

// One Philox 4x32-10 block.
std::array<std::uint32_t, 4> philox(std::array<std::uint32_t, 4> counter,
                                    std::array<std::uint32_t, 2> key);

class CounterRandom {
 public:
  CounterRandom(std::uint64_t seed, std::uint64_t stream) : seed_(seed), stream_(stream) {}

  // 64 random bits, number `index` of the stream.
  std::uint64_t bits(std::uint64_t index) const;
  // Uniform in (0, 1): neither end is ever returned.
  double uniform(std::uint64_t index) const;
  // Standard normal (Box and Muller); uses the whole block of `index`.
  double normal(std::uint64_t index) const;
  // Two independent standard normals for the price of one.
  std::array<double, 2> normal_pair(std::uint64_t index) const;

 private:
  std::array<std::uint32_t, 4> block(std::uint64_t index) const;

  std::uint64_t seed_;
  std::uint64_t stream_;
};

}  // namespace gastronaut

#include "numerics/counter_random.hpp"

#include <cmath>
#include <numbers>

namespace gastronaut {
namespace {

constexpr std::uint32_t kMultiplier0 = 0xD2511F53;
constexpr std::uint32_t kMultiplier1 = 0xCD9E8D57;
constexpr std::uint32_t kWeyl0 = 0x9E3779B9;
constexpr std::uint32_t kWeyl1 = 0xBB67AE85;
constexpr int kRounds = 10;

std::uint32_t high(std::uint64_t product) { return static_cast<std::uint32_t>(product >> 32); }
std::uint32_t low(std::uint64_t product) { return static_cast<std::uint32_t>(product); }

// (k + 1/2) 2^-53 for the 53 high bits k: symmetric about one half, ends excluded.
double to_uniform(std::uint32_t upper, std::uint32_t lower) {
  const std::uint64_t k = ((std::uint64_t{upper} << 32) | lower) >> 11;
  return (static_cast<double>(k) + 0.5) * 0x1p-53;
}

}  // namespace

std::array<std::uint32_t, 4> philox(std::array<std::uint32_t, 4> counter,
                                    std::array<std::uint32_t, 2> key) {
  for (int round = 0; round < kRounds; ++round) {
    const std::uint64_t product0 = std::uint64_t{kMultiplier0} * counter[0];
    const std::uint64_t product1 = std::uint64_t{kMultiplier1} * counter[2];
    counter = {high(product1) ^ counter[1] ^ key[0], low(product1),
               high(product0) ^ counter[3] ^ key[1], low(product0)};
    key[0] += kWeyl0;
    key[1] += kWeyl1;
  }
  return counter;
}

std::array<std::uint32_t, 4> CounterRandom::block(std::uint64_t index) const {
  return philox({low(index), high(index), low(stream_), high(stream_)}, {low(seed_), high(seed_)});
}

std::uint64_t CounterRandom::bits(std::uint64_t index) const {
  const auto b = block(index);
  return (std::uint64_t{b[1]} << 32) | b[0];
}

double CounterRandom::uniform(std::uint64_t index) const {
  const auto b = block(index);
  return to_uniform(b[1], b[0]);
}

std::array<double, 2> CounterRandom::normal_pair(std::uint64_t index) const {
  const auto b = block(index);
  const double radius = std::sqrt(-2 * std::log(to_uniform(b[1], b[0])));
  const double angle = 2 * std::numbers::pi * to_uniform(b[3], b[2]);
  return {radius * std::cos(angle), radius * std::sin(angle)};
}

double CounterRandom::normal(std::uint64_t index) const { return normal_pair(index)[0]; }

}  // namespace gastronaut

#include "virtual_rig/gradient_noise.hpp"

#include <array>

namespace gastronaut {
namespace {

std::uint32_t hash(std::uint32_t mixed) {
  std::uint32_t h = mixed;
  h = (h ^ (h >> 15)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12)) * 0x297A2D39u;
  return h ^ (h >> 15);
}

// A gradient's component from ten bits: evenly in -kReach..kReach. The reach gives the noise the
// variance of the usual twelve gradients.
constexpr float kReach = 1.41421356F;
float component(std::uint32_t bits) {
  return static_cast<float>(static_cast<std::int32_t>(bits & 1023u)) * (2 * kReach / 1023) - kReach;
}

}  // namespace

NoiseSample gradient_noise(const Eigen::Vector3f& point, std::uint32_t seed) {
  std::array<float, 3> local{};
  std::array<std::uint32_t, 3> cell{};
  std::array<std::array<float, 2>, 3> weight{};
  std::array<float, 3> slope{};
  for (int i = 0; i < 3; ++i) {
    const auto n = static_cast<std::size_t>(i);
    // Without std::floor, which the baseline instruction set does by a call.
    const auto truncated = static_cast<std::int32_t>(point[i]);
    const std::int32_t below = truncated - (point[i] < static_cast<float>(truncated) ? 1 : 0);
    const float t = point[i] - static_cast<float>(below);
    local[n] = t;
    cell[n] = static_cast<std::uint32_t>(below);
    const float fade = t * t * t * (t * (t * 6 - 15) + 10);
    weight[n] = {1 - fade, fade};
    slope[n] = 30 * t * t * (t * (t - 2) + 1);
  }
  // All eight corners of the cell at once, as arrays that the compiler turns into vectors.
  constexpr std::size_t kCorners = 8;
  std::array<std::uint32_t, kCorners> mixed{};
  std::array<std::array<float, kCorners>, 3> from{};
  std::array<std::array<float, kCorners>, 3> fade{};
  std::array<std::array<float, kCorners>, 3> fade_slope{};
  constexpr std::array<std::uint32_t, 3> kPrimes = {0x8DA6B343u, 0xD8163841u, 0xCB1AB31Fu};
  for (std::size_t corner = 0; corner < kCorners; ++corner) {
    mixed[corner] = seed;
    for (std::size_t n = 0; n < 3; ++n) {
      const std::size_t side = (corner >> n) & 1u;
      mixed[corner] ^= (cell[n] + static_cast<std::uint32_t>(side)) * kPrimes[n];
      from[n][corner] = local[n] - static_cast<float>(side);
      fade[n][corner] = weight[n][side];
      fade_slope[n][corner] = side == 1 ? slope[n] : -slope[n];
    }
  }
  std::array<float, kCorners> value{};
  std::array<std::array<float, kCorners>, 3> gradient{};
  for (std::size_t corner = 0; corner < kCorners; ++corner) {
    const std::uint32_t bits = hash(mixed[corner]);
    const float gx = component(bits);
    const float gy = component(bits >> 10);
    const float gz = component(bits >> 20);
    const float dot = gx * from[0][corner] + gy * from[1][corner] + gz * from[2][corner];
    const float xy = fade[0][corner] * fade[1][corner];
    const float yz = fade[1][corner] * fade[2][corner];
    const float xz = fade[0][corner] * fade[2][corner];
    const float all = xy * fade[2][corner];
    value[corner] = all * dot;
    gradient[0][corner] = all * gx + fade_slope[0][corner] * yz * dot;
    gradient[1][corner] = all * gy + fade_slope[1][corner] * xz * dot;
    gradient[2][corner] = all * gz + fade_slope[2][corner] * xy * dot;
  }
  NoiseSample sample{0, Eigen::Vector3f::Zero()};
  for (std::size_t corner = 0; corner < kCorners; ++corner) {
    sample.value += value[corner];
    for (int n = 0; n < 3; ++n) sample.gradient[n] += gradient[static_cast<std::size_t>(n)][corner];
  }
  return sample;
}

}  // namespace gastronaut

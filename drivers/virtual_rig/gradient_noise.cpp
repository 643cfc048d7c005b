#include "virtual_rig/gradient_noise.hpp"

#include <array>
#include <cmath>

namespace gastronaut {
namespace {

std::uint32_t hash(std::uint32_t x, std::uint32_t y, std::uint32_t z, std::uint32_t seed) {
  std::uint32_t h = seed ^ (x * 0x8DA6B343u) ^ (y * 0xD8163841u) ^ (z * 0xCB1AB31Fu);
  h = (h ^ (h >> 15)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12)) * 0x297A2D39u;
  return h ^ (h >> 15);
}

// The twelve edges of a cube, four of them twice.
constexpr std::array<std::array<float, 3>, 16> kGradients = {{{1, 1, 0},
                                                              {-1, 1, 0},
                                                              {1, -1, 0},
                                                              {-1, -1, 0},
                                                              {1, 0, 1},
                                                              {-1, 0, 1},
                                                              {1, 0, -1},
                                                              {-1, 0, -1},
                                                              {0, 1, 1},
                                                              {0, -1, 1},
                                                              {0, 1, -1},
                                                              {0, -1, -1},
                                                              {1, 1, 0},
                                                              {-1, 1, 0},
                                                              {0, -1, 1},
                                                              {0, -1, -1}}};

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
  NoiseSample sample{0, Eigen::Vector3f::Zero()};
  for (std::uint32_t corner = 0; corner < 8; ++corner) {
    const std::uint32_t i = corner & 1u;
    const std::uint32_t j = (corner >> 1) & 1u;
    const std::uint32_t k = corner >> 2;
    const auto& g = kGradients[hash(cell[0] + i, cell[1] + j, cell[2] + k, seed) >> 28];
    const float dot = g[0] * (local[0] - static_cast<float>(i)) +
                      g[1] * (local[1] - static_cast<float>(j)) +
                      g[2] * (local[2] - static_cast<float>(k));
    const float wx = weight[0][i];
    const float wy = weight[1][j];
    const float wz = weight[2][k];
    const float w = wx * wy * wz;
    sample.value += w * dot;
    sample.gradient.x() += w * g[0] + (i ? slope[0] : -slope[0]) * wy * wz * dot;
    sample.gradient.y() += w * g[1] + (j ? slope[1] : -slope[1]) * wx * wz * dot;
    sample.gradient.z() += w * g[2] + (k ? slope[2] : -slope[2]) * wx * wy * dot;
  }
  return sample;
}

}  // namespace gastronaut

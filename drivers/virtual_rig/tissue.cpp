#include "virtual_rig/tissue.hpp"

#include <algorithm>

#include "numerics/parallel.hpp"
#include "virtual_rig/gradient_noise.hpp"

namespace gastronaut {
namespace {

constexpr double kVesselDensity = 400;  // metres per square metre at organ.vessels = 1
constexpr float kNoiseSigma = 0.27F;    // of gradient_noise
constexpr std::size_t kVerticesPerChunk = 8192;
// What blood takes from red, green and blue where it covers all.
const Eigen::Vector3f kBlood(0.16F, 0.55F, 0.48F);
constexpr float kGrain = 0.0009F;   // wavelength of what is drawn at every hit, metres
constexpr float kRipple = 0.07F;    // tilt of the film per unit of the grain's gradient
constexpr float kFresnel = 0.028F;  // reflectance of water at normal incidence, with pi absorbed

enum Noise : std::uint32_t { kBrightness = 101, kRedness, kFilm, kGloss, kMottling, kGraining };

NoiseSample noise(const Eigen::Vector3f& point, float wavelength, std::uint64_t seed,
                  std::uint32_t which) {
  return gradient_noise(point / wavelength,
                        static_cast<std::uint32_t>(seed * 0x9E3779B1u + which * 0x85EBCA77u));
}

}  // namespace

Tissue::Tissue(const OrganConfiguration& organ, const TriangleMesh& rest)
    : organ_(organ), vessels_(rest, kVesselDensity * organ.vessels, organ.seed) {
  slow_.resize(rest.vertices.size());
  const auto variation = static_cast<float>(organ.variation) / kNoiseSigma;
  parallel_for_chunks(slow_.size(), kVerticesPerChunk, [&](auto begin, auto end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector3f& p = rest.vertices[i];
      const float brightness = 0.8F * noise(p, 0.03F, organ.seed, kBrightness).value +
                               0.6F * noise(p, 0.011F, organ.seed, kBrightness + 50).value;
      const float redness = noise(p, 0.02F, organ.seed, kRedness).value;
      const float film = noise(p, 0.014F, organ.seed, kFilm).value;
      const float gloss = noise(p, 0.009F, organ.seed, kGloss).value;
      const float mottle = 0.4F * noise(p, 0.0022F, organ.seed, kMottling).value;
      slow_[i].brightness = 1 + variation * (brightness + mottle);
      slow_[i].redness = variation * (redness - 0.5F * mottle);
      slow_[i].film =
          static_cast<float>(organ.mucus) * kFresnel * std::clamp(0.55F + 1.6F * film, 0.05F, 1.0F);
      slow_[i].exponent = std::clamp(160 * (1 + 2 * gloss), 40.0F, 400.0F);
    }
  });
  float mean = 0;
  for (const Slow& slow : slow_) mean += slow.brightness / static_cast<float>(slow_.size());
  for (Slow& slow : slow_) slow.brightness /= mean;
}

TissueSample Tissue::sample(const Triangle& corners, const std::array<float, 3>& weights,
                            const Eigen::Vector3f& rest_point) const {
  Slow slow{0, 0, 0, 0};
  for (std::size_t i = 0; i < 3; ++i) {
    const Slow& corner = slow_[corners[i]];
    slow.brightness += weights[i] * corner.brightness;
    slow.redness += weights[i] * corner.redness;
    slow.film += weights[i] * corner.film;
    slow.exponent += weights[i] * corner.exponent;
  }
  const NoiseSample fine = noise(rest_point, kGrain, organ_.seed, kGraining);
  const float grain = static_cast<float>(organ_.variation) / kNoiseSigma * 0.25F * fine.value;
  const float vessel = vessels_.at(rest_point);
  TissueSample sample;
  sample.albedo = organ_.albedo.cast<float>() * (slow.brightness + grain);
  sample.albedo.tail<2>() *= 1 - slow.redness + 0.5F * grain;
  sample.albedo = sample.albedo.cwiseProduct(Eigen::Vector3f::Ones() - vessel * kBlood);
  sample.albedo = sample.albedo.cwiseMin(1.0F).cwiseMax(0.0F);
  sample.film = slow.film;
  sample.exponent = slow.exponent;
  sample.ripple = kRipple * fine.gradient;
  return sample;
}

}  // namespace gastronaut

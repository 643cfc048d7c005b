#include "visual_slam/window_kernels.hpp"

#include <cstdint>
#include <cstring>

// The vectors below never leave this file, so how they would be passed does not matter.
#pragma GCC diagnostic ignored "-Wpsabi"

// Compiled once for each instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "visual_slam/window_kernels.cpp"
#include <hwy/foreach_target.h>  // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace gastronaut::slam::HWY_NAMESPACE {

// A patch in the compiler's own vectors, which become whatever registers the target has.
typedef float Lanes __attribute__((vector_size(kPatchPixels * sizeof(float))));
typedef std::int32_t Integers __attribute__((vector_size(kPatchPixels * sizeof(std::int32_t))));
typedef float Quad __attribute__((vector_size(sizeof(Texel))));

HWY_INLINE Lanes load(const PatchLanes& from) {
  Lanes lanes;
  std::memcpy(&lanes, from.data(), sizeof lanes);
  return lanes;
}
HWY_INLINE Lanes all(float value) { return value - Lanes{}; }
HWY_INLINE float sum(Lanes lanes) {
  Quad halves[2];
  static_assert(sizeof halves == sizeof lanes);
  std::memcpy(halves, &lanes, sizeof halves);
  const Quad pairs = halves[0] + halves[1];
  return (pairs[0] + pairs[2]) + (pairs[1] + pairs[3]);
}
HWY_INLINE bool none(Integers lanes) {
  std::int64_t words[sizeof lanes / sizeof(std::int64_t)];
  std::memcpy(words, &lanes, sizeof words);
  return (words[0] | words[1] | words[2] | words[3]) == 0;
}
HWY_INLINE Quad texel(const Texel* from) {
  Quad quad;
  std::memcpy(&quad, from, sizeof quad);
  return quad;
}

struct Seen {
  Lanes value, gradient_x, gradient_y, depth;
};

HWY_INLINE Seen look(const Texture& texture, const Lanes& at_u, const Lanes& at_v) {
  const Integers column = __builtin_convertvector(at_u, Integers);
  const Integers line = __builtin_convertvector(at_v, Integers);
  const Lanes part_u = at_u - __builtin_convertvector(column, Lanes);
  const Lanes part_v = at_v - __builtin_convertvector(line, Lanes);
  const std::ptrdiff_t stride = texture.grid.width;
  float found[4][kPatchPixels];
  for (std::size_t i = 0; i < kPatchPixels; ++i) {
    const Texel* from = texture.texels.data() + line[i] * stride + column[i];
    const Quad top_left = texel(from);
    const Quad bottom_left = texel(from + stride);
    const Quad top = top_left + part_u[i] * (texel(from + 1) - top_left);
    const Quad bottom = bottom_left + part_u[i] * (texel(from + stride + 1) - bottom_left);
    const Quad between = top + part_v[i] * (bottom - top);
    for (std::size_t k = 0; k < 4; ++k) found[k][i] = between[k];
  }
  Seen seen;
  std::memcpy(&seen.value, found[0], sizeof seen.value);
  std::memcpy(&seen.gradient_x, found[1], sizeof seen.gradient_x);
  std::memcpy(&seen.gradient_y, found[2], sizeof seen.gradient_y);
  std::memcpy(&seen.depth, found[3], sizeof seen.depth);
  return seen;
}

ViewSums look_at_patches(const std::vector<WindowPoint>& points, const std::vector<float>& ratios,
                         const Texture& target, const PatchView& view,
                         std::vector<PatchSums>& patches) {
  const auto fx = static_cast<float>(target.grid.fx);
  const auto fy = static_cast<float>(target.grid.fy);
  const auto cx = static_cast<float>(target.grid.cx);
  const auto cy = static_cast<float>(target.grid.cy);
  const auto last_u = static_cast<float>(target.grid.width - 1);
  const auto last_v = static_cast<float>(target.grid.height - 1);
  const std::array<float, 9>& r = view.target_R_host;
  const float inverse2 = 1 / (kCauchyScale * kCauchyScale * view.sigma * view.sigma);
  const Lanes zero{};
  const Lanes one = all(1);
  Lanes matrix[triangle(kTwist)] = {};
  Lanes vector[kTwist] = {};
  patches.resize(points.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const WindowPoint& point = points[i];
    PatchSums& sums = patches[i];
    sums = {};
    const Lanes depth = ratios[i] * load(point.depth);
    const Lanes hx = load(point.ray_x) * depth;
    const Lanes hy = load(point.ray_y) * depth;
    // From the target's camera: the part that grows with the depth, and all of it.
    const Lanes gx = r[0] * hx + r[1] * hy + r[2] * depth;
    const Lanes gy = r[3] * hx + r[4] * hy + r[5] * depth;
    const Lanes gz = r[6] * hx + r[7] * hy + r[8] * depth;
    const Lanes px = gx + view.target_t_host[0];
    const Lanes py = gy + view.target_t_host[1];
    const Lanes pz = gz + view.target_t_host[2];
    const Integers ahead = pz > 0;
    const Lanes inverse_z = one / (ahead ? pz : one);
    const Lanes at_u = fx * px * inverse_z + cx;
    const Lanes at_v = fy * py * inverse_z + cy;
    const Integers inside = ahead & (at_u >= 0) & (at_u < last_u) & (at_v >= 0) & (at_v < last_v);
    if (none(inside)) continue;
    const Seen seen = look(target, inside ? at_u : zero, inside ? at_v : zero);
    const Lanes e = seen.value - load(point.value);
    const Lanes off = view.target_scale * seen.depth * inverse_z - one;
    const Integers hidden = (off > view.depth_gate) | (off < -view.depth_gate);
    const Integers alike = inside & ~hidden & (e < view.value_gate) & (e > -view.value_gate) &
                           (seen.gradient_x == seen.gradient_x) &
                           (seen.gradient_y == seen.gradient_y);
    const Lanes residual = alike ? e : zero;
    const Lanes weight = (alike ? one : zero) / (one + residual * residual * inverse2);
    sums.weight = sum(weight);
    if (!(sums.weight > 0)) continue;

    const Lanes jx = (alike ? seen.gradient_x : zero) * fx * inverse_z;
    const Lanes jy = (alike ? seen.gradient_y : zero) * fy * inverse_z;
    const Lanes jz = -(jx * px + jy * py) * inverse_z;
    const Lanes twist[kTwist] = {
        jx, jy, jz, py * jz - pz * jy, pz * jx - px * jz, px * jy - py * jx};
    const Lanes weighted_ratio = weight * (jx * gx + jy * gy + jz * gz);
    std::size_t k = 0;
    for (std::size_t a = 0; a < kTwist; ++a) {
      const Lanes weighted = weight * twist[a];
      for (std::size_t b = a; b < kTwist; ++b) matrix[k++] += weighted * twist[b];
      vector[a] += weighted * residual;
      sums.twist_ratio[a] = sum(weighted_ratio * twist[a]);
    }
    sums.ratio2 = sum(weighted_ratio * (jx * gx + jy * gy + jz * gz));
    sums.ratio_residual = sum(weighted_ratio * residual);
    sums.square = sum(weight * residual * residual);
  }
  ViewSums total;
  for (std::size_t k = 0; k < total.matrix.size(); ++k) total.matrix[k] = sum(matrix[k]);
  for (std::size_t k = 0; k < kTwist; ++k) total.vector[k] = sum(vector[k]);
  return total;
}

}  // namespace gastronaut::slam::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gastronaut::slam {

HWY_EXPORT(look_at_patches);

ViewSums look_at_patches(const std::vector<WindowPoint>& points, const std::vector<float>& ratios,
                         const Texture& target, const PatchView& view,
                         std::vector<PatchSums>& patches) {
  return HWY_DYNAMIC_DISPATCH(look_at_patches)(points, ratios, target, view, patches);
}

}  // namespace gastronaut::slam
#endif  // HWY_ONCE

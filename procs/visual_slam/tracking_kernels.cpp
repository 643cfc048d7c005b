#include "visual_slam/tracking_kernels.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>

// The vectors below never leave this file, so how they would be passed does not matter.
#pragma GCC diagnostic ignored "-Wpsabi"

// Compiled once for each instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "visual_slam/tracking_kernels.cpp"
#include <hwy/foreach_target.h>  // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace gastronaut::slam::HWY_NAMESPACE {

// Sixteen columns at a time in the compiler's own vectors, which become whatever registers the
// target has; there is no contraction to fused operations in the whole project.
typedef float Lanes __attribute__((vector_size(kTrackingLanes * sizeof(float))));
typedef std::int32_t Integers __attribute__((vector_size(kTrackingLanes * sizeof(std::int32_t))));

constexpr int kWindow = 8;  // pixels from the middle of the contrast's window to its border
static_assert(kWindow <= kTrackingLanes);
constexpr float kLeastShare = 0.5F;  // of the window that must not be masked
constexpr float kNone = std::numeric_limits<float>::quiet_NaN();

HWY_INLINE Lanes load(const float* from) {
  Lanes lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}
HWY_INLINE void store(Lanes lanes, float* to) { std::memcpy(to, &lanes, sizeof lanes); }
HWY_INLINE Lanes all(float value) { return value - Lanes{}; }
HWY_INLINE Lanes columns() {
  Lanes lanes;
  for (int i = 0; i < kTrackingLanes; ++i) lanes[i] = static_cast<float>(i);
  return lanes;
}

HWY_INLINE double sum(Lanes lanes) {
  double total = 0;
  for (int i = 0; i < kTrackingLanes; ++i) total += static_cast<double>(lanes[i]);
  return total;
}

void normalise_contrast(FrameLevel& level, float floor, int begin, int end) {
  const int width = level.raw_albedo.width;
  const int height = level.raw_albedo.height;
  const auto right = static_cast<float>(level.grid.width - kWindow);
  // Sums down the window's columns, with a margin of nothing on both sides.
  const auto length = static_cast<std::size_t>(width + 2 * kTrackingLanes);
  std::vector<float> buffer(3 * length, 0.0F);
  float* count = buffer.data() + kTrackingLanes;
  float* first = count + length;
  float* second = first + length;
  const auto add_row = [&](int v, float sign) {
    if (v < 0 || v >= height) return;
    const float* row = level.raw_albedo.row(v);
    for (int u = 0; u < width; u += kTrackingLanes) {
      const Lanes a = load(row + u);
      const Integers seen = a == a;
      const Lanes value = seen ? a : all(0);
      store(load(count + u) + (seen ? all(sign) : all(0)), count + u);
      store(load(first + u) + sign * value, first + u);
      store(load(second + u) + sign * (value * value), second + u);
    }
  };
  for (int v = begin - kWindow; v < begin + kWindow; ++v) add_row(v, 1);
  for (int v = begin; v < end; ++v) {
    add_row(v + kWindow, 1);
    const float* raw = level.raw_albedo.row(v);
    float* normalised = level.albedo.row(v);
    const bool inside_rows = v >= kWindow && v < height - kWindow;
    for (int u = 0; u < width; u += kTrackingLanes) {
      Lanes n{}, s{}, ss{};
      for (int i = u - kWindow; i <= u + kWindow; ++i) {
        n += load(count + i);
        s += load(first + i);
        ss += load(second + i);
      }
      constexpr float kSide = 2 * kWindow + 1;
      // A window that the picture's border cuts shows other tissue when the camera moves: the
      // same point's contrast would change with it, and a motion would be seen in that.
      const Lanes column = columns() + static_cast<float>(u);
      const Integers enough = (n >= kLeastShare * kSide * kSide) & (column >= kWindow) &
                              (column < right) & (all(inside_rows ? 1.0F : 0.0F) > 0);
      n = enough ? n : all(1);
      const Lanes mean = s / n;
      const Lanes variance = ss / n - mean * mean;
      float deviation[kTrackingLanes];
      store(variance > 0 ? variance : all(0), deviation);
      for (float& each : deviation) each = std::sqrt(each);
      const Lanes spread = load(deviation) + floor * mean;
      const Lanes value = (load(raw + u) - mean) / (spread > 0 ? spread : all(1));
      store(enough ? value : all(kNone), normalised + u);
    }
    add_row(v - kWindow, -1);
  }
}

struct Corners {
  Lanes top_left, top_right, bottom_left, bottom_right;
};

HWY_INLINE Corners corners(const float* plane, int stride, const std::int32_t* index) {
  float values[4][kTrackingLanes];
  for (int i = 0; i < kTrackingLanes; ++i) {
    const float* from = plane + index[i];
    values[0][i] = from[0];
    values[1][i] = from[1];
    values[2][i] = from[stride];
    values[3][i] = from[stride + 1];
  }
  return {load(values[0]), load(values[1]), load(values[2]), load(values[3])};
}

HWY_INLINE Lanes between(const Corners& c, Lanes fu, Lanes fv) {
  const Lanes top = c.top_left + fu * (c.top_right - c.top_left);
  const Lanes bottom = c.bottom_left + fu * (c.bottom_right - c.bottom_left);
  return top + fv * (bottom - top);
}

HWY_INLINE Lanes smaller(Lanes a, Lanes b) { return a < b ? a : b; }
HWY_INLINE Lanes larger(Lanes a, Lanes b) { return a > b ? a : b; }

template <int kUnknowns>
HWY_INLINE void add_normal_equations(const Lanes* row, Lanes weight, Lanes residual, Lanes* matrix,
                                     Lanes* vector, Lanes* gradient) {
  int k = 0;
  for (int i = 0; i < kUnknowns; ++i) {
    const Lanes weighted = weight * row[i];
    for (int j = i; j < kUnknowns; ++j) matrix[k++] += weighted * row[j];
    gradient[i] = weighted * residual;
    vector[i] += gradient[i];
  }
}

TrackingSums compare(const ModelLevel& model, const FrameLevel& frame, const TrackingState& state,
                     int begin, int end, BlockGradient* blocks) {
  const auto fx = static_cast<float>(model.grid.fx);
  const auto fy = static_cast<float>(model.grid.fy);
  const auto cx = static_cast<float>(model.grid.cx);
  const auto cy = static_cast<float>(model.grid.cy);
  const auto last_u = static_cast<float>(frame.grid.width - 1);
  const auto last_v = static_cast<float>(frame.grid.height - 1);
  const int stride = frame.depth.width;
  const std::array<float, 9>& r = state.frame_R_model;
  const float icp_inverse2 = 1 / (kCauchyScale * kCauchyScale * state.icp_sigma * state.icp_sigma);
  const float rgb_inverse2 = 1 / (kCauchyScale * kCauchyScale * state.rgb_sigma * state.rgb_sigma);
  const Lanes zero{};
  const Lanes one = all(1);
  Lanes sums[kTrackingSums] = {};
  for (int v = begin; v < end; ++v) {
    const float ray_y = (static_cast<float>(v) - cy) / fy;
    for (int u = 0; u < model.depth.width; u += kTrackingLanes) {
      const Lanes ray_x = (columns() + static_cast<float>(u) - cx) / fx;
      const Lanes depth = load(model.depth.row(v) + u);
      const Integers known = depth > 0;
      const Lanes pz = known ? depth : zero;
      const Lanes px = ray_x * pz;
      const Lanes py = ray_y * pz;
      const Lanes dx = px - state.centre[0];
      const Lanes dy = py - state.centre[1];
      const Lanes dz = pz - state.centre[2];
      const Lanes fz = r[6] * dx + r[7] * dy + r[8] * dz;
      const Integers ahead = known & (fz > 0);
      const Lanes inverse_z = one / (ahead ? fz : one);
      const Lanes at_u = fx * (r[0] * dx + r[1] * dy + r[2] * dz) * inverse_z + cx;
      const Lanes at_v = fy * (r[3] * dx + r[4] * dy + r[5] * dz) * inverse_z + cy;
      const Lanes nx = load(model.normal_x.row(v) + u);
      const Lanes ny = load(model.normal_y.row(v) + u);
      const Lanes nz = load(model.normal_z.row(v) + u);
      const Lanes nd = nx * dx + ny * dy + nz * dz;
      const Lanes nn = nx * nx + ny * ny + nz * nz;
      const Lanes dd = dx * dx + dy * dy + dz * dz;
      const Integers usable = ahead & (at_u >= 0) & (at_u < last_u) & (at_v >= 0) &
                              (at_v < last_v) & (nd < 0) &
                              (nd * nd > state.cosine_gate2 * (nn * dd));
      const Lanes safe_u = usable ? at_u : zero;
      const Lanes safe_v = usable ? at_v : zero;
      const Integers column = __builtin_convertvector(safe_u, Integers);
      const Integers line = __builtin_convertvector(safe_v, Integers);
      const Lanes part_u = safe_u - __builtin_convertvector(column, Lanes);
      const Lanes part_v = safe_v - __builtin_convertvector(line, Lanes);
      std::int32_t index[kTrackingLanes];
      const Integers offset = line * stride + column;
      std::memcpy(index, &offset, sizeof index);

      const Corners c = corners(frame.depth.values.data(), stride, index);
      const Lanes nearest =
          smaller(smaller(c.top_left, c.top_right), smaller(c.bottom_left, c.bottom_right));
      const Lanes furthest =
          larger(larger(c.top_left, c.top_right), larger(c.bottom_left, c.bottom_right));
      const Lanes q = state.depth_scale * between(c, part_u, part_v) * inverse_z - 1;
      const Integers measured = usable & (q == q);
      const Integers near = measured & (furthest - nearest < state.jump * nearest) &
                            (q < state.distance_gate) & (-q < state.distance_gate);
      const Lanes inverse_nd = (usable ? one : zero) / (usable ? nd : one);
      const Lanes tx = (usable ? nx : zero) * inverse_nd;
      const Lanes ty = (usable ? ny : zero) * inverse_nd;
      const Lanes tz = (usable ? nz : zero) * inverse_nd;
      const Lanes icp = near ? q : zero;
      const Lanes icp_weight = (near ? one : zero) / (1 + icp * icp * icp_inverse2);
      const Lanes icp_row[kIcpUnknowns] = {
          -tx, -ty, -tz, pz * ty - py * tz, px * tz - pz * tx, py * tx - px * ty, 1 + icp};
      Lanes icp_gradient[kIcpUnknowns];
      add_normal_equations<kIcpUnknowns>(icp_row, icp_weight, icp, sums + kIcpMatrix,
                                         sums + kIcpVector, icp_gradient);

      // What hides P or lies far behind it says nothing about P's colour.
      const Lanes seen =
          between(corners(frame.albedo.values.data(), stride, index), part_u, part_v);
      const Lanes expected = load(model.albedo.row(v) + u);
      const Lanes gradient_x = load(model.gradient_x.row(v) + u) * fx;
      const Lanes gradient_y = load(model.gradient_y.row(v) + u) * fy;
      const Lanes e = seen - expected;
      const Integers alike = usable & (near | ~measured) & (e < state.rgb_gate) &
                             (-e < state.rgb_gate) & (gradient_x == gradient_x) &
                             (gradient_y == gradient_y);
      const Lanes inverse_pz = (alike ? one : zero) / (alike ? pz : one);
      const Lanes gx = (alike ? gradient_x : zero) * inverse_pz;
      const Lanes gy = (alike ? gradient_y : zero) * inverse_pz;
      const Lanes gz = -(gx * ray_x + gy * ray_y);
      const Lanes gd = gx * dx + gy * dy + gz * dz;
      const Lanes jx = gx - tx * gd;
      const Lanes jy = gy - ty * gd;
      const Lanes jz = gz - tz * gd;
      const Lanes rgb = alike ? e : zero;
      const Lanes rgb_weight = (alike ? one : zero) / (1 + rgb * rgb * rgb_inverse2);
      const Lanes rgb_row[kRgbUnknowns] = {
          jx, jy, jz, py * jz - pz * jy, pz * jx - px * jz, px * jy - py * jx};
      Lanes rgb_gradient[kRgbUnknowns];
      add_normal_equations<kRgbUnknowns>(rgb_row, rgb_weight, rgb, sums + kRgbMatrix,
                                         sums + kRgbVector, rgb_gradient);

      const Lanes square = icp_weight * icp * icp;
      sums[kIcpWeight] += icp_weight;
      sums[kIcpSquare] += square;
      sums[kIcpMetres2] += square * (nd * nd) / (near ? nn : one);
      sums[kIcpInliers] += icp_weight > 0.5F ? one : zero;
      sums[kIcpCompared] += measured ? one : zero;
      sums[kRgbWeight] += rgb_weight;
      sums[kRgbSquare] += rgb_weight * rgb * rgb;
      sums[kRgbInliers] += rgb_weight > 0.5F ? one : zero;
      sums[kRgbCompared] += usable & (e == e) ? one : zero;
      const Lanes a = alike ? seen : zero;
      const Lanes b = alike ? expected : zero;
      sums[kFrameAlbedo2] += a * a;
      sums[kModelAlbedo2] += b * b;
      sums[kAlbedoProduct] += a * b;
      sums[kVisible] += known ? one : zero;
      sums[kDepthSum] += pz;
      if (blocks) {
        BlockGradient& block = blocks[u / kTrackingLanes];
        for (std::size_t i = 0; i < kIcpUnknowns; ++i) block.icp[i] += sum(icp_gradient[i]);
        for (std::size_t i = 0; i < kRgbUnknowns; ++i) block.rgb[i] += sum(rgb_gradient[i]);
      }
    }
  }
  TrackingSums totals;
  for (std::size_t k = 0; k < kTrackingSums; ++k) totals[k] = sum(sums[k]);
  return totals;
}

}  // namespace gastronaut::slam::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gastronaut::slam {

HWY_EXPORT(normalise_contrast);
HWY_EXPORT(compare);

void normalise_contrast(FrameLevel& level, float floor, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(normalise_contrast)(level, floor, begin, end);
}
TrackingSums compare(const ModelLevel& model, const FrameLevel& frame, const TrackingState& state,
                     int begin, int end, BlockGradient* blocks) {
  return HWY_DYNAMIC_DISPATCH(compare)(model, frame, state, begin, end, blocks);
}

}  // namespace gastronaut::slam
#endif  // HWY_ONCE

#include "depth_estimator/shape_kernels.hpp"

#include <cmath>
#include <cstdint>
#include <cstring>

// The vectors below never leave this file, so how they would be passed does not matter.
#pragma GCC diagnostic ignored "-Wpsabi"

// Compiled once for each instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "depth_estimator/shape_kernels.cpp"
#include <hwy/foreach_target.h>  // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace gastronaut::perception::HWY_NAMESPACE {

// Sixteen columns at a time in the compiler's own vectors, which become whatever registers the
// target has; there is no contraction to fused operations in the whole project.
typedef float Lanes __attribute__((vector_size(kShapeLanes * sizeof(float))));
typedef std::int32_t Integers __attribute__((vector_size(kShapeLanes * sizeof(std::int32_t))));

constexpr float kLog2E = 1.44269504F;
constexpr float kLn2 = 0.693147181F;

HWY_INLINE Lanes load(const float* from) {
  Lanes lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}
HWY_INLINE void store(Lanes lanes, float* to) { std::memcpy(to, &lanes, sizeof lanes); }
HWY_INLINE Lanes all(float value) { return value - Lanes{}; }

HWY_INLINE double sum(Lanes lanes) {
  double total = 0;
  for (int i = 0; i < kShapeLanes; ++i) total += static_cast<double>(lanes[i]);
  return total;
}

HWY_INLINE Lanes square_root(Lanes lanes) {
  float values[kShapeLanes];
  store(lanes, values);
  for (float& value : values) value = std::sqrt(value);
  return load(values);
}

// log2 of positive normal numbers; error below 3e-7 absolute.
HWY_INLINE Lanes log2_of(Lanes x) {
  // Mantissa in [sqrt(1/2), sqrt(2)): atanh's series in (m - 1) / (m + 1).
  constexpr std::int32_t kSqrtHalf = 0x3F3504F3;
  const Integers bits = reinterpret_cast<Integers>(x) - kSqrtHalf;
  const Lanes exponent = __builtin_convertvector(bits >> 23, Lanes);
  const Lanes m = reinterpret_cast<Lanes>((bits & 0x007FFFFF) + kSqrtHalf);
  const Lanes t = (m - 1) / (m + 1);
  const Lanes t2 = t * t;
  const Lanes series = t * (2 + t2 * (2.0F / 3 + t2 * (2.0F / 5 + t2 * (2.0F / 7))));
  return exponent + kLog2E * series;
}

// 2^x for abs(x) < 126; relative error below 3e-7.
HWY_INLINE Lanes exp2_of(Lanes x) {
  constexpr float kRound = 12582912.0F;  // 1.5 * 2^23: adding it rounds to whole numbers
  const Lanes whole = (x + kRound) - kRound;
  const Lanes f = (x - whole) * kLn2;
  const Lanes series =
      1 + f * (1 + f * (1.0F / 2 +
                        f * (1.0F / 6 + f * (1.0F / 24 + f * (1.0F / 120 + f * (1.0F / 720))))));
  const Integers exponent = (__builtin_convertvector(whole, Integers) + 127) << 23;
  return series * reinterpret_cast<Lanes>(exponent);
}

void linearise(ShapeGrid& grid, const ShapeLights& lights, const ShapeWeights& weights, int begin,
               int end) {
  const int width = grid.padded_width;
  const int stride = grid.zeta.stride();
  const int num_lights = static_cast<int>(lights.x.size());
  const float lobe = lights.lobe;
  const float power = (lobe + 3) / 2;
  const float inverse_cauchy2 = 1 / (weights.cauchy * weights.cauchy);
  const float floor2 = weights.cosine_floor * weights.cosine_floor;
  const auto focal = static_cast<float>(grid.camera.fx * grid.camera.fy);
  const float smoothness = focal * weights.smoothness;
  const float* light_x = lights.x.data();
  const float* light_y = lights.y.data();
  for (int v = begin; v < end; ++v) {
    const float y = static_cast<float>((v - grid.camera.cy) / grid.camera.fy);
    const bool first = v == 0;
    const bool last = v == grid.camera.height - 1;
    const auto fy = static_cast<float>(grid.camera.fy);
    const float up_d = first ? 0 : (last ? -fy : -fy / 2);
    const float down_d = last ? 0 : (first ? fy : fy / 2);
    const float own_d = -(up_d + down_d);
    const float has_second_y = first || last ? 0.0F : 1.0F;
    const float has_mixed_y = last ? 0.0F : 1.0F;
    const float* __restrict zeta = grid.zeta.row(v);
    const float* __restrict log_light = grid.log_light.row(v);
    const float* __restrict inverse_variance = grid.inverse_variance.row(v);
    const float* __restrict edge = grid.edge.row(v);
    const float* __restrict ray_x = grid.ray_x.data();
    const float* __restrict left_d = grid.left.data();
    const float* __restrict mid_d = grid.own.data();
    const float* __restrict right_d = grid.right.data();
    const float* __restrict has_second = grid.has_second.data();
    const float* __restrict has_mixed = grid.has_mixed.data();
    float* __restrict own_c = grid.own_c.row(v);
    float* __restrict left_c = grid.left_c.row(v);
    float* __restrict right_c = grid.right_c.row(v);
    float* __restrict up_c = grid.up_c.row(v);
    float* __restrict down_c = grid.down_c.row(v);
    float* __restrict weighted = grid.weighted_residual.row(v);
    float* __restrict residual = grid.residual.row(v);
    float* __restrict smooth_x = grid.smooth_x.row(v);
    float* __restrict smooth_y = grid.smooth_y.row(v);
    float* __restrict smooth_xy = grid.smooth_xy.row(v);
    float* __restrict second_x = grid.second_x.row(v);
    float* __restrict second_y = grid.second_y.row(v);
    float* __restrict second_xy = grid.second_xy.row(v);
    for (int u = 0; u < width; u += kShapeLanes) {
      const Lanes x = load(ray_x + u);
      const Lanes c = load(zeta + u);
      const Lanes z = exp2_of(kLog2E * c);
      const Lanes px = x * z;
      const Lanes py = y * z;
      // W(P) and its derivative by zeta, P moving along its ray.
      Lanes wx{}, wy{}, wz{}, dx{}, dy{}, dz{};
      for (int k = 0; k < num_lights; ++k) {
        const Lanes way_x = light_x[k] - px;
        const Lanes way_y = light_y[k] - py;
        const Lanes distance2 = way_x * way_x + way_y * way_y + z * z;
        const Lanes strength = exp2_of(lobe * (kLog2E * c) - power * log2_of(distance2));
        const Lanes along = way_x * px + way_y * py - z * z;
        const Lanes growth = strength * (lobe + 2 * power * along / distance2);
        wx += strength * way_x;
        wy += strength * way_y;
        wz -= strength * z;
        dx += growth * way_x - strength * px;
        dy += growth * way_y - strength * py;
        dz -= growth * z + strength * z;
      }
      const Lanes l = load(zeta + u - 1);
      const Lanes r = load(zeta + u + 1);
      const Lanes t = load(zeta + u - stride);
      const Lanes b = load(zeta + u + stride);
      const Lanes left_dx = load(left_d + u);
      const Lanes own_dx = load(mid_d + u);
      const Lanes right_dx = load(right_d + u);
      const Lanes zx = left_dx * l + own_dx * c + right_dx * r;
      const Lanes zy = up_d * t + own_d * c + down_d * b;
      // N = P_x x P_y up to a positive factor, towards the camera.
      const Lanes nz = -(1 + x * zx + y * zy);
      const Lanes nn = zx * zx + zy * zy + nz * nz;
      const Lanes nw = zx * wx + zy * wy + nz * wz;
      const Lanes floor = floor2 * nn * (wx * wx + wy * wy + wz * wz);
      const Lanes square = nw * nw;
      const Integers lit = (nw > 0) & (square > floor);
      const Lanes error = load(log_light + u) - 0.5F * kLn2 * log2_of((lit ? square : floor) / nn);
      // In shadow only the fall-off with distance counts.
      const Lanes inverse_nw = (lit ? all(1) : all(0)) / (lit ? nw : all(1));
      const Lanes inverse_nn = (lit ? all(1) : all(0)) / nn;
      const Lanes jx = (wx - x * wz) * inverse_nw - (zx - x * nz) * inverse_nn;
      const Lanes jy = (wy - y * wz) * inverse_nw - (zy - y * nz) * inverse_nn;
      const Lanes jz = lit ? (zx * dx + zy * dy + nz * dz) * inverse_nw : all(-2);
      const Lanes confidence = load(inverse_variance + u);
      const Lanes weight =
          square_root(confidence / (1 + error * error * confidence * inverse_cauchy2));
      store(weight * (jz + own_dx * jx + own_d * jy), own_c + u);
      store(weight * left_dx * jx, left_c + u);
      store(weight * right_dx * jx, right_c + u);
      store(weight * up_d * jy, up_c + u);
      store(weight * down_d * jy, down_c + u);
      store(weight * error, weighted + u);
      store(error, residual + u);
      // The second difference of zeta times focal length^2 / z is the wall's curvature.
      const Lanes curvature = smoothness / z;
      const Lanes s = curvature * curvature * load(edge + u);
      const Lanes sx = s * load(has_second + u);
      const Lanes sy = s * has_second_y;
      const Lanes sxy = 2 * s * load(has_mixed + u) * has_mixed_y;
      store(sx, smooth_x + u);
      store(sy, smooth_y + u);
      store(sxy, smooth_xy + u);
      store(sx * (l - 2 * c + r), second_x + u);
      store(sy * (t - 2 * c + b), second_y + u);
      store(sxy * (c - r - b + load(zeta + u + stride + 1)), second_xy + u);
    }
  }
}

// Each coefficient of A gathers what the residuals around it put there, so rows are independent.
double assemble(ShapeGrid& grid, const ShapeWeights& weights, int begin, int end) {
  const int s = grid.zeta.stride();
  Lanes total{};
  for (int v = begin; v < end; ++v) {
    const float* __restrict o = grid.own_c.row(v);
    const float* __restrict l = grid.left_c.row(v);
    const float* __restrict r = grid.right_c.row(v);
    const float* __restrict u = grid.up_c.row(v);
    const float* __restrict d = grid.down_c.row(v);
    const float* __restrict e = grid.weighted_residual.row(v);
    const float* __restrict wx = grid.smooth_x.row(v);
    const float* __restrict wy = grid.smooth_y.row(v);
    const float* __restrict wm = grid.smooth_xy.row(v);
    const float* __restrict qx = grid.second_x.row(v);
    const float* __restrict qy = grid.second_y.row(v);
    const float* __restrict qm = grid.second_xy.row(v);
    float* __restrict a00 = grid.a00.row(v);
    float* __restrict a10 = grid.a10.row(v);
    float* __restrict a20 = grid.a20.row(v);
    float* __restrict a01 = grid.a01.row(v);
    float* __restrict a02 = grid.a02.row(v);
    float* __restrict a11 = grid.a11.row(v);
    float* __restrict am11 = grid.am11.row(v);
    float* __restrict inverse_diagonal = grid.inverse_diagonal.row(v);
    float* __restrict gradient = grid.remainder.row(v);
    float* __restrict preconditioned = grid.preconditioned.row(v);
    float* __restrict direction = grid.direction.row(v);
    float* __restrict step = grid.step.row(v);
    for (int i = 0; i < grid.padded_width; ++i) {
      const float diagonal = o[i] * o[i] + r[i - 1] * r[i - 1] + l[i + 1] * l[i + 1] +
                             d[i - s] * d[i - s] + u[i + s] * u[i + s] + 4 * (wx[i] + wy[i]) +
                             wx[i - 1] + wx[i + 1] + wy[i - s] + wy[i + s] + wm[i] + wm[i - 1] +
                             wm[i - s] + wm[i - s - 1] + weights.damping;
      a00[i] = diagonal;
      a10[i] = o[i] * r[i] + l[i + 1] * o[i + 1] - 2 * (wx[i] + wx[i + 1]) - wm[i] - wm[i - s];
      a01[i] = o[i] * d[i] + u[i + s] * o[i + s] - 2 * (wy[i] + wy[i + s]) - wm[i] - wm[i - 1];
      a20[i] = l[i + 1] * r[i + 1] + wx[i + 1];
      a02[i] = u[i + s] * d[i + s] + wy[i + s];
      a11[i] = l[i + 1] * d[i + 1] + u[i + s] * r[i + s] + wm[i];
      am11[i] = r[i - 1] * d[i - 1] + u[i + s] * l[i + s] + wm[i - 1];
      const float g = o[i] * e[i] + r[i - 1] * e[i - 1] + l[i + 1] * e[i + 1] +
                      d[i - s] * e[i - s] + u[i + s] * e[i + s] + 2 * (qx[i] + qy[i]) - qx[i - 1] -
                      qx[i + 1] - qy[i - s] - qy[i + s] - qm[i] + qm[i - 1] + qm[i - s] -
                      qm[i - s - 1];
      inverse_diagonal[i] = 1 / diagonal;
      gradient[i] = g;
      preconditioned[i] = g * inverse_diagonal[i];
      direction[i] = preconditioned[i];
      step[i] = 0;
    }
    for (int i = 0; i < grid.padded_width; i += kShapeLanes) {
      total += load(gradient + i) * load(preconditioned + i);
    }
  }
  return sum(total);
}

double multiply(ShapeGrid& grid, int begin, int end) {
  const int s = grid.zeta.stride();
  Lanes total{};
  for (int v = begin; v < end; ++v) {
    const float* __restrict p = grid.direction.row(v);
    const float* __restrict a00 = grid.a00.row(v);
    const float* __restrict a10 = grid.a10.row(v);
    const float* __restrict a20 = grid.a20.row(v);
    const float* __restrict a01 = grid.a01.row(v);
    const float* __restrict a02 = grid.a02.row(v);
    const float* __restrict a11 = grid.a11.row(v);
    const float* __restrict am11 = grid.am11.row(v);
    float* __restrict product = grid.product.row(v);
    for (int i = 0; i < grid.padded_width; ++i) {
      product[i] = a00[i] * p[i] + a10[i] * p[i + 1] + a10[i - 1] * p[i - 1] + a20[i] * p[i + 2] +
                   a20[i - 2] * p[i - 2] + a01[i] * p[i + s] + a01[i - s] * p[i - s] +
                   a02[i] * p[i + 2 * s] + a02[i - 2 * s] * p[i - 2 * s] + a11[i] * p[i + s + 1] +
                   a11[i - s - 1] * p[i - s - 1] + am11[i] * p[i + s - 1] +
                   am11[i - s + 1] * p[i - s + 1];
    }
    for (int i = 0; i < grid.padded_width; i += kShapeLanes) {
      total += load(product + i) * load(p + i);
    }
  }
  return sum(total);
}

double advance(ShapeGrid& grid, float alpha, int begin, int end) {
  Lanes total{};
  for (int v = begin; v < end; ++v) {
    const float* direction = grid.direction.row(v);
    const float* product = grid.product.row(v);
    const float* inverse_diagonal = grid.inverse_diagonal.row(v);
    float* step = grid.step.row(v);
    float* remainder = grid.remainder.row(v);
    float* preconditioned = grid.preconditioned.row(v);
    for (int i = 0; i < grid.padded_width; i += kShapeLanes) {
      store(load(step + i) + alpha * load(direction + i), step + i);
      const Lanes r = load(remainder + i) - alpha * load(product + i);
      const Lanes z = r * load(inverse_diagonal + i);
      store(r, remainder + i);
      store(z, preconditioned + i);
      total += r * z;
    }
  }
  return sum(total);
}

void turn(ShapeGrid& grid, float beta, int begin, int end) {
  for (int v = begin; v < end; ++v) {
    const float* preconditioned = grid.preconditioned.row(v);
    float* direction = grid.direction.row(v);
    for (int i = 0; i < grid.padded_width; i += kShapeLanes) {
      store(load(preconditioned + i) + beta * load(direction + i), direction + i);
    }
  }
}

}  // namespace gastronaut::perception::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gastronaut::perception {

HWY_EXPORT(linearise);
HWY_EXPORT(assemble);
HWY_EXPORT(multiply);
HWY_EXPORT(advance);
HWY_EXPORT(turn);

void linearise(ShapeGrid& grid, const ShapeLights& lights, const ShapeWeights& weights, int begin,
               int end) {
  HWY_DYNAMIC_DISPATCH(linearise)(grid, lights, weights, begin, end);
}
double assemble(ShapeGrid& grid, const ShapeWeights& weights, int begin, int end) {
  return HWY_DYNAMIC_DISPATCH(assemble)(grid, weights, begin, end);
}
double multiply(ShapeGrid& grid, int begin, int end) {
  return HWY_DYNAMIC_DISPATCH(multiply)(grid, begin, end);
}
double advance(ShapeGrid& grid, float alpha, int begin, int end) {
  return HWY_DYNAMIC_DISPATCH(advance)(grid, alpha, begin, end);
}
void turn(ShapeGrid& grid, float beta, int begin, int end) {
  HWY_DYNAMIC_DISPATCH(turn)(grid, beta, begin, end);
}

}  // namespace gastronaut::perception
#endif  // HWY_ONCE

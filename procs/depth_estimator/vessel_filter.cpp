#include "depth_estimator/vessel_filter.hpp"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "depth_estimator/vessel_filter.cpp"
#include <hwy/foreach_target.h>
#include <hwy/highway.h>

// Compiled once for each instruction set: the row kernels. They work on whole vectors, beyond a
// row's end if need be (rows are padded); each pixel's value is the same sequence of additions,
// multiplications, divisions and square roots everywhere, whatever the vector's length.
HWY_BEFORE_NAMESPACE();
namespace gastronaut::perception::HWY_NAMESPACE {
namespace {

namespace hn = hwy::HWY_NAMESPACE;
using Tag = hn::CappedTag<float, 16>;
using Vector = hn::Vec<Tag>;
constexpr Tag kTag;

int lanes() { return static_cast<int>(hn::Lanes(kTag)); }

// 2^x for -120 <= x <= 0, relative error under 3e-6, exact for 0.
Vector exp2(Vector x) {
  // Adding it rounds to an integer, which then stands in the lowest bits.
  const Vector rounder = hn::Set(kTag, 12582912.0F);  // 1.5 * 2^23
  const Vector shifted = hn::Add(x, rounder);
  const Vector f = hn::Sub(x, hn::Sub(shifted, rounder));
  // Minimax for the relative error over [-1/2, 1/2] with the constant term 1.
  Vector p = hn::Set(kTag, 9.582853029e-3F);
  p = hn::Add(hn::Mul(p, f), hn::Set(kTag, 5.590642459e-2F));
  p = hn::Add(hn::Mul(p, f), hn::Set(kTag, 2.402409861e-1F));
  p = hn::Add(hn::Mul(p, f), hn::Set(kTag, 6.931241934e-1F));
  p = hn::Add(hn::Mul(p, f), hn::Set(kTag, 1.0F));
  const hn::RebindToUnsigned<Tag> bits;
  return hn::BitCast(kTag,
                     hn::Add(hn::BitCast(bits, p), hn::ShiftLeft<23>(hn::BitCast(bits, shifted))));
}

// rows[-radius..radius] -> each column's Gaussian, first and second derivative.
void filter_columns(const float* const* rows, const float* smooth, const float* first,
                    const float* second, int radius, int width, float* smoothed, float* slope,
                    float* curvature) {
  for (int u = 0; u < width; u += lanes()) {
    const Vector centre = hn::Load(kTag, rows[0] + u);
    Vector sum0 = hn::Mul(centre, hn::Set(kTag, smooth[0]));
    Vector sum1 = hn::Zero(kTag);
    Vector sum2 = hn::Mul(centre, hn::Set(kTag, second[0]));
    for (int i = 1; i <= radius; ++i) {
      const Vector above = hn::Load(kTag, rows[-i] + u);
      const Vector below = hn::Load(kTag, rows[i] + u);
      const Vector even = hn::Add(above, below);
      const Vector odd = hn::Sub(below, above);
      sum0 = hn::Add(sum0, hn::Mul(even, hn::Set(kTag, smooth[i])));
      sum1 = hn::Add(sum1, hn::Mul(odd, hn::Set(kTag, first[i])));
      sum2 = hn::Add(sum2, hn::Mul(even, hn::Set(kTag, second[i])));
    }
    hn::Store(sum0, kTag, smoothed + u);
    hn::Store(sum1, kTag, slope + u);
    hn::Store(sum2, kTag, curvature + u);
  }
}

// The same along the rows that filter_columns gave, to the Hessian's three components.
void filter_rows(const float* smoothed, const float* slope, const float* curvature,
                 const float* smooth, const float* first, const float* second, int radius,
                 int width, float* sum, float* difference, float* cross) {
  for (int u = 0; u < width; u += lanes()) {
    Vector xx = hn::Mul(hn::Load(kTag, smoothed + u), hn::Set(kTag, second[0]));
    Vector yy = hn::Mul(hn::Load(kTag, curvature + u), hn::Set(kTag, smooth[0]));
    Vector xy = hn::Zero(kTag);
    for (int i = 1; i <= radius; ++i) {
      const Vector even_xx =
          hn::Add(hn::LoadU(kTag, smoothed + u - i), hn::LoadU(kTag, smoothed + u + i));
      const Vector even_yy =
          hn::Add(hn::LoadU(kTag, curvature + u - i), hn::LoadU(kTag, curvature + u + i));
      const Vector odd_xy = hn::Sub(hn::LoadU(kTag, slope + u + i), hn::LoadU(kTag, slope + u - i));
      xx = hn::Add(xx, hn::Mul(even_xx, hn::Set(kTag, second[i])));
      yy = hn::Add(yy, hn::Mul(even_yy, hn::Set(kTag, smooth[i])));
      xy = hn::Add(xy, hn::Mul(odd_xy, hn::Set(kTag, first[i])));
    }
    hn::Store(hn::Add(xx, yy), kTag, sum + u);
    hn::Store(hn::Sub(xx, yy), kTag, difference + u);
    hn::Store(hn::Add(xy, xy), kTag, cross + u);
  }
}

// Four rows' weighted sum.
void blend_rows(const float* const* rows, const float* weights, int width, float* out) {
  for (int u = 0; u < width; u += lanes()) {
    Vector sum = hn::Mul(hn::Load(kTag, rows[0] + u), hn::Set(kTag, weights[0]));
    for (int i = 1; i < 4; ++i) {
      sum = hn::Add(sum, hn::Mul(hn::Load(kTag, rows[i] + u), hn::Set(kTag, weights[i])));
    }
    hn::Store(sum, kTag, out + u);
  }
}

// Doubles a row: in[u] lies between out[2 u] and out[2 u + 1]. weights: of in[u - 1] to in[u + 2]
// for the latter, mirrored for the former.
void double_row(const float* in, const float* weights, int width, float* out) {
  const Vector w0 = hn::Set(kTag, weights[0]);
  const Vector w1 = hn::Set(kTag, weights[1]);
  const Vector w2 = hn::Set(kTag, weights[2]);
  const Vector w3 = hn::Set(kTag, weights[3]);
  for (int u = 0; u < width; u += lanes()) {
    const Vector left2 = hn::LoadU(kTag, in + u - 2);
    const Vector left = hn::LoadU(kTag, in + u - 1);
    const Vector centre = hn::Mul(hn::Load(kTag, in + u), w1);
    const Vector right = hn::LoadU(kTag, in + u + 1);
    const Vector right2 = hn::LoadU(kTag, in + u + 2);
    const Vector even = hn::Add(hn::Add(centre, hn::Mul(left, w2)),
                                hn::Add(hn::Mul(right, w0), hn::Mul(left2, w3)));
    const Vector odd = hn::Add(hn::Add(centre, hn::Mul(right, w2)),
                               hn::Add(hn::Mul(left, w0), hn::Mul(right2, w3)));
    hn::StoreInterleaved2(even, odd, kTag, out + 2 * static_cast<std::ptrdiff_t>(u));
  }
}

// Six rows' weighted sum, symmetric: weights of the innermost, middle, outermost pair.
void halve_columns(const float* const* rows, const float* weights, int width, float* out) {
  for (int u = 0; u < width; u += lanes()) {
    Vector sum = hn::Zero(kTag);
    for (int i = 0; i < 3; ++i) {
      const Vector pair = hn::Add(hn::Load(kTag, rows[2 - i] + u), hn::Load(kTag, rows[3 + i] + u));
      sum = hn::Add(sum, hn::Mul(pair, hn::Set(kTag, weights[i])));
    }
    hn::Store(sum, kTag, out + u);
  }
}

// The same along a row: out[u] from in[2 u - 2] to in[2 u + 3].
void halve_row(const float* in, const float* weights, int width, float* out) {
  for (int u = 0; u < width; u += lanes()) {
    const float* centre = in + 2 * static_cast<std::ptrdiff_t>(u);
    Vector even[3];
    Vector odd[3];
    for (int i = 0; i < 3; ++i) {
      hn::LoadInterleaved2(kTag, centre - 2 + 2 * i, even[i], odd[i]);
    }
    Vector sum = hn::Mul(hn::Add(even[1], odd[1]), hn::Set(kTag, weights[0]));
    sum = hn::Add(sum, hn::Mul(hn::Add(odd[0], even[2]), hn::Set(kTag, weights[1])));
    sum = hn::Add(sum, hn::Mul(hn::Add(even[0], odd[2]), hn::Set(kTag, weights[2])));
    hn::Store(sum, kTag, out + u);
  }
}

// response = max(response, this scale's). With sum = l1 + l2 and root = abs(l1 - l2), the
// eigenvalue of larger magnitude is positive where sum > 0; then l1 / l2 is
// (sum - root) / (sum + root), and l1^2 + l2^2 is (sum^2 + root^2) / 2.
void respond(const float* sum, const float* difference, const float* cross, float ratio_factor,
             float norm_factor, int width, float* response) {
  const Vector lowest = hn::Set(kTag, -120.0F);
  for (int u = 0; u < width; u += lanes()) {
    const Vector s = hn::Load(kTag, sum + u);
    const Vector d = hn::Load(kTag, difference + u);
    const Vector c = hn::Load(kTag, cross + u);
    const Vector square = hn::Add(hn::Mul(d, d), hn::Mul(c, c));
    const Vector root = hn::Sqrt(square);
    const Vector ratio = hn::Div(hn::Sub(s, root), hn::Add(s, root));
    const Vector norm = hn::Add(hn::Mul(s, s), square);
    const Vector line =
        exp2(hn::Max(lowest, hn::Mul(hn::Mul(ratio, ratio), hn::Set(kTag, ratio_factor))));
    const Vector flat = exp2(hn::Max(lowest, hn::Mul(norm, hn::Set(kTag, norm_factor))));
    const Vector vessel = hn::Mul(line, hn::Sub(hn::Set(kTag, 1.0F), flat));
    const Vector dark = hn::IfThenElseZero(hn::Gt(s, hn::Zero(kTag)), vessel);
    hn::Store(hn::Max(hn::Load(kTag, response + u), dark), kTag, response + u);
  }
}

}  // namespace
}  // namespace gastronaut::perception::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <stdexcept>

#include "numerics/parallel.hpp"

namespace gastronaut::perception {
namespace {

HWY_EXPORT(filter_columns);
HWY_EXPORT(filter_rows);
HWY_EXPORT(blend_rows);
HWY_EXPORT(double_row);
HWY_EXPORT(halve_columns);
HWY_EXPORT(halve_row);
HWY_EXPORT(respond);

// Rows are padded to whole vectors of every instruction set, twice (a doubled row is twice as
// long as the whole vectors of the row that it comes from).
constexpr int kPadding = 32;
// Room for the mirrored pixels on either side of a row.
constexpr int kMargin = 16;
// Kernels reach to four standard deviations, where the second derivative is 0.5 % of its peak.
constexpr double kReach = 4;
// A scale is computed on the smallest picture where its Gaussian still has this width; cubic
// interpolation of the Hessian then keeps the response within a few per cent of its peak.
constexpr double kMinimumWidth = 1.1;
// What that bounds: halving once more would have left less than kMinimumWidth.
constexpr int kMaximumRadius = 12;
static_assert(kMaximumRadius <= kMargin);
// Rows that a thread takes at a time.
constexpr int kBandRows = 16;

// Cubic Lagrange weights of the samples at -1, 0, 1, 2 for the position 1/4.
constexpr std::array<float, 4> kQuarter = {-7.0F / 128, 105.0F / 128, 35.0F / 128, -5.0F / 128};

// Before every second pixel is left out: Gaussian at +-1/2, +-3/2, +-5/2 pixels, of standard
// deviation 1, which leaves 4 % of what would be mistaken for a detail of the coarse grid's finest
// used frequency.
std::array<float, 3> halving_weights() {
  std::array<double, 3> weights{};
  double total = 0;
  for (int i = 0; i < 3; ++i) {
    weights[i] = std::exp(-0.5 * (i + 0.5) * (i + 0.5));
    total += 2 * weights[i];
  }
  return {static_cast<float>(weights[0] / total), static_cast<float>(weights[1] / total),
          static_cast<float>(weights[2] / total)};
}

double halving_variance() {
  const auto weights = halving_weights();
  double variance = 0;
  for (int i = 0; i < 3; ++i) variance += 2.0 * weights[i] * (i + 0.5) * (i + 0.5);
  return variance;
}

int halved(int size) { return (size + 1) / 2; }

int padded(int width) { return (width + kPadding - 1) / kPadding * kPadding; }

// Index of the pixel that stands for pixel i of a mirrored row: ... 1 0 | 0 1 2 ... n-1 | n-1 ...
struct Mirrored {
  int index;
  bool reversed;  // seen in the mirror
};

Mirrored mirrored(int i, int size) {
  int folded = i % (2 * size);
  if (folded < 0) folded += 2 * size;
  if (folded < size) return {folded, false};
  return {2 * size - 1 - folded, true};
}

// Fills `reach` pixels left and right of the row. sign: of a mirrored pixel (-1 for a derivative
// across the mirror).
void mirror_ends(float* row, int width, int reach, float sign) {
  for (int i = 1; i <= reach; ++i) {
    for (const int u : {-i, width - 1 + i}) {
      const Mirrored source = mirrored(u, width);
      row[u] = source.reversed ? sign * row[source.index] : row[source.index];
    }
  }
}

template <class Body>
void for_row_bands(int rows, const Body& body) {
  parallel_for_chunks(static_cast<std::size_t>(rows), kBandRows,
                      [&](std::size_t begin, std::size_t end) {
                        body(static_cast<int>(begin), static_cast<int>(end));
                      });
}

}  // namespace

// Row buffers for one band, with margins.
class VesselFilter::Workspace {
 public:
  Workspace(int rows, int width)
      : stride_(padded(width) + 2 * kMargin),
        values_(static_cast<std::size_t>(rows) * static_cast<std::size_t>(stride_)) {}
  float* row(int i) { return values_.data() + static_cast<std::ptrdiff_t>(i) * stride_ + kMargin; }

 private:
  int stride_;
  Buffer values_;
};

VesselFilter::PaddedPlane::PaddedPlane(int width_, int height_)
    : width(width_),
      height(height_),
      stride(padded(width_)),
      values(static_cast<std::size_t>(stride) * static_cast<std::size_t>(height_)) {}

float* VesselFilter::PaddedPlane::row(int v) {
  return values.data() + static_cast<std::ptrdiff_t>(v) * stride;
}

const float* VesselFilter::PaddedPlane::row(int v) const {
  return values.data() + static_cast<std::ptrdiff_t>(v) * stride;
}

VesselFilter::Scale VesselFilter::plan_scale(double scale, int width, int height) {
  if (!(scale >= kMinimumVesselScale && scale <= kMaximumVesselScale)) {
    throw std::invalid_argument("a vessel scale must lie between 0.7 and 64 pixels");
  }
  // Halving adds its own variance, each time on pixels of twice the size.
  double variance = scale * scale;
  Scale plan;
  for (;;) {
    const double next = (variance - halving_variance()) / 4;
    if (next < kMinimumWidth * kMinimumWidth) break;
    variance = next;
    ++plan.level;
    width = halved(width);
    height = halved(height);
    HessianPlanes planes;
    planes.sum = planes.difference = planes.cross = PaddedPlane(width, height);
    plan.hessians.push_back(std::move(planes));
  }
  const double pixel = std::ldexp(1.0, plan.level);
  plan.radius = static_cast<int>(kReach * std::sqrt(variance) + 0.5);

  // Sampled and cut Gaussian derivatives, corrected so that constants, slopes and parabolas give
  // exactly what they should.
  std::vector<double> gaussian, second;
  for (int i = 0; i <= plan.radius; ++i) {
    gaussian.push_back(std::exp(-0.5 * i * i / variance));
    second.push_back((i * i / variance - 1) * gaussian.back());
  }
  double mass = gaussian[0];
  double moment = 0;  // of the first derivative, sum of i * i * gaussian
  double bias = second[0];
  for (int i = 1; i <= plan.radius; ++i) {
    mass += 2 * gaussian[i];
    moment += 2 * i * i * gaussian[i];
    bias += 2 * second[i];
  }
  double curvature = 0;
  for (int i = 0; i <= plan.radius; ++i) {
    second[i] -= bias / mass * gaussian[i];
    curvature += i * i * second[i];
  }
  const double normalisation = scale / pixel;
  for (int i = 0; i <= plan.radius; ++i) {
    plan.smooth.push_back(static_cast<float>(gaussian[i] / mass));
    plan.first.push_back(static_cast<float>(normalisation * i * gaussian[i] / moment));
    plan.second.push_back(
        static_cast<float>(normalisation * normalisation * second[i] / curvature));
  }
  return plan;
}

VesselFilter::VesselFilter(int width, int height, const VesselFilterOptions& options) {
  if (width < 1 || height < 1) {
    throw std::invalid_argument("the vessel filter wants a picture of at least one pixel");
  }
  if (options.scales.empty()) throw std::invalid_argument("the vessel filter wants a scale");
  if (!(options.beta > 0 && options.structureness > 0)) {
    throw std::invalid_argument("the vessel filter's beta and structureness must be positive");
  }
  // The kernels take powers of two.
  ratio_factor_ = static_cast<float>(-std::numbers::log2e / (2 * options.beta * options.beta));
  norm_factor_ = static_cast<float>(-std::numbers::log2e /
                                    (4 * options.structureness * options.structureness));
  pyramid_.emplace_back(width, height);
  for (const double scale : options.scales) {
    scales_.push_back(plan_scale(scale, width, height));
    while (pyramid_.size() <= static_cast<std::size_t>(scales_.back().level)) {
      pyramid_.emplace_back(halved(pyramid_.back().width), halved(pyramid_.back().height));
    }
  }
}

void VesselFilter::apply(const Plane<float>& picture, Plane<float>& response) {
  if (!picture.same_size(pyramid_[0].width, pyramid_[0].height)) {
    throw std::invalid_argument("the vessel filter was built for pictures of another size");
  }
  copy_picture(picture);
  for (std::size_t i = 1; i < pyramid_.size(); ++i) halve(pyramid_[i - 1], pyramid_[i]);
  for (int level = static_cast<int>(pyramid_.size()) - 1; level > 0; --level) {
    compute_coarse_hessians(level);
  }
  compute_response(response);
}

void VesselFilter::copy_picture(const Plane<float>& picture) {
  for_row_bands(picture.height, [&](int begin, int end) {
    for (int v = begin; v < end; ++v) {
      std::copy_n(picture.row(v), picture.width, pyramid_[0].row(v));
    }
  });
}

void VesselFilter::halve(const PaddedPlane& fine, PaddedPlane& coarse) {
  const std::array<float, 3> weights = halving_weights();
  for_row_bands(coarse.height, [&](int begin, int end) {
    Workspace scratch(1, fine.width);
    float* blended = scratch.row(0);
    std::array<const float*, 6> rows{};
    for (int v = begin; v < end; ++v) {
      for (int i = 0; i < 6; ++i) rows[i] = fine.row(mirrored(2 * v - 2 + i, fine.height).index);
      HWY_DYNAMIC_DISPATCH(halve_columns)(rows.data(), weights.data(), fine.width, blended);
      mirror_ends(blended, fine.width, 4, 1);
      HWY_DYNAMIC_DISPATCH(halve_row)(blended, weights.data(), coarse.width, coarse.row(v));
    }
  });
}

void VesselFilter::compute_hessian_row(const Scale& scale, int level, int v, Workspace& scratch,
                                       float* sum, float* difference, float* cross) const {
  if (level == scale.level) {
    const PaddedPlane& picture = pyramid_[static_cast<std::size_t>(level)];
    std::array<const float*, 2 * kMaximumRadius + 1> rows{};
    for (int i = -scale.radius; i <= scale.radius; ++i) {
      rows[scale.radius + i] = picture.row(mirrored(v + i, picture.height).index);
    }
    HWY_DYNAMIC_DISPATCH(filter_columns)
    (rows.data() + scale.radius, scale.smooth.data(), scale.first.data(), scale.second.data(),
     scale.radius, picture.width, scratch.row(0), scratch.row(1), scratch.row(2));
    for (int i = 0; i < 3; ++i) mirror_ends(scratch.row(i), picture.width, scale.radius, 1);
    HWY_DYNAMIC_DISPATCH(filter_rows)
    (scratch.row(0), scratch.row(1), scratch.row(2), scale.smooth.data(), scale.first.data(),
     scale.second.data(), scale.radius, picture.width, sum, difference, cross);
    return;
  }
  const HessianPlanes& coarse = scale.hessians[static_cast<std::size_t>(level)];
  const auto double_up = [&](const PaddedPlane& plane, float mirror_sign, float* blended,
                             float* out) {
    const int step = v % 2 == 0 ? -1 : 1;  // the second nearest row is on this side
    std::array<const float*, 4> rows{};
    std::array<float, 4> weights = kQuarter;
    for (int i = 0; i < 4; ++i) {
      const Mirrored source = mirrored(v / 2 + step * (i - 1), plane.height);
      rows[i] = plane.row(source.index);
      if (source.reversed) weights[i] *= mirror_sign;
    }
    HWY_DYNAMIC_DISPATCH(blend_rows)(rows.data(), weights.data(), plane.width, blended);
    mirror_ends(blended, plane.width, 2, mirror_sign);
    HWY_DYNAMIC_DISPATCH(double_row)(blended, kQuarter.data(), plane.width, out);
  };
  double_up(coarse.sum, 1, scratch.row(0), sum);
  double_up(coarse.difference, 1, scratch.row(1), difference);
  double_up(coarse.cross, -1, scratch.row(2), cross);
}

void VesselFilter::compute_coarse_hessians(int level) {
  const PaddedPlane& picture = pyramid_[static_cast<std::size_t>(level)];
  for_row_bands(picture.height, [&](int begin, int end) {
    Workspace scratch(3, picture.width);
    for (int v = begin; v < end; ++v) {
      for (Scale& scale : scales_) {
        if (scale.level < level) continue;
        HessianPlanes& planes = scale.hessians[static_cast<std::size_t>(level - 1)];
        compute_hessian_row(scale, level, v, scratch, planes.sum.row(v), planes.difference.row(v),
                            planes.cross.row(v));
      }
    }
  });
}

void VesselFilter::compute_response(Plane<float>& response) const {
  const int width = pyramid_[0].width;
  const int height = pyramid_[0].height;
  if (!response.same_size(width, height)) response = Plane<float>(width, height);
  for_row_bands(height, [&](int begin, int end) {
    Workspace work(7, width);
    float* sum = work.row(3);
    float* difference = work.row(4);
    float* cross = work.row(5);
    float* strongest = work.row(6);
    for (int v = begin; v < end; ++v) {
      std::fill_n(strongest, width, 0.0F);
      for (const Scale& scale : scales_) {
        compute_hessian_row(scale, 0, v, work, sum, difference, cross);
        HWY_DYNAMIC_DISPATCH(respond)
        (sum, difference, cross, ratio_factor_, norm_factor_, width, strongest);
      }
      std::copy_n(strongest, width, response.row(v));
    }
  });
}

}  // namespace gastronaut::perception

#endif  // HWY_ONCE

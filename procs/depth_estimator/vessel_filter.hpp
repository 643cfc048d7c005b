// Multi-scale vessel enhancement: dark, line-like structures on brighter tissue, after Frangi,
// Niessen, Vincken and Viergever, "Multiscale vessel enhancement filtering", MICCAI 1998, in two
// dimensions.
#pragma once

#include <tbb/cache_aligned_allocator.h>

#include <vector>

#include "image/plane.hpp"

namespace gastronaut::perception {

struct VesselFilterOptions {
  // Standard deviations of the Gaussian, in pixels, each in [kMinimumVesselScale,
  // kMaximumVesselScale]. A dark line with a Gaussian profile of standard deviation w answers most
  // at s = sqrt(2) w.
  std::vector<double> scales = {1, 1.6, 2.5, 4, 6};
  // Frangi's beta: how blob-like a structure may be, in units of l1/l2.
  double beta = 0.5;
  // Frangi's c: the Hessian norm, in levels (0..1) after scale normalisation, that answers 0.39;
  // twice that answers 0.86. It is fixed, not taken from each picture as in the paper, so that
  // the answer does not flicker with the strongest edge in view and stays 0 in the dark. A line of
  // depth A (levels) and of the scale's own best width has a Hessian norm of 0.38 A.
  double structureness = 0.03;
};

inline constexpr double kMinimumVesselScale = 0.7;  // below, a pixel grid cannot carry the kernel
inline constexpr double kMaximumVesselScale = 64;

// With H = s^2 times the Hessian of the picture smoothed by a Gaussian of standard deviation s, and
// its eigenvalues abs(l1) <= abs(l2), the response at scale s is
//   0                                                             where l2 <= 0 or l1 = -l2
//   exp(-(l1 / l2)^2 / (2 beta^2)) (1 - exp(-(l1^2 + l2^2) / (2 c^2)))   elsewhere,
// and the filter's response the maximum over the scales. Beyond its border the picture is mirrored,
// the border pixel twice (scikit-image's "reflect").
//
// Coarse scales: their Hessian is computed on the picture halved once or several times (sampled
// from a Gaussian that counts as part of the scale's own), and interpolated back, component by
// component, by cubic polynomials; the response is always computed at full resolution.
//
// The buffers are kept from picture to picture. The result is the same, bit by bit, whatever the
// number of threads and the instruction set. Not for use by two threads at once.
class VesselFilter {
 public:
  // Throws std::invalid_argument for a width or height under 1, no scale or one outside the bounds
  // above, or a beta or structureness that is not positive.
  VesselFilter(int width, int height, const VesselFilterOptions& options);

  // picture: levels 0 (black) to 1 (white), as displayed (gamma-encoded), of the constructor's size
  // (else std::invalid_argument); the green channel shows vessels best.
  // response: 0 (no vessel) to 1, same size; resized if need be.
  void apply(const Plane<float>& picture, Plane<float>& response);

 private:
  using Buffer = std::vector<float, tbb::cache_aligned_allocator<float>>;

  // Rows that whole vectors may be read from and written to.
  struct PaddedPlane {
    int width = 0;
    int height = 0;
    int stride = 0;
    Buffer values;

    PaddedPlane() = default;
    PaddedPlane(int width_, int height_);
    float* row(int v);
    const float* row(int v) const;
  };

  // Of a symmetric 2 x 2 matrix [a b; b c]: a + c, a - c, 2 b.
  struct HessianPlanes {
    PaddedPlane sum, difference, cross;
  };

  // Weights of Gaussian, first and second derivative at offsets 0 to radius; those at negative
  // offsets follow by symmetry. The scale's normalisation is part of the derivatives.
  struct Scale {
    int level = 0;  // computed on the picture halved this many times
    int radius = 0;
    std::vector<float> smooth, first, second;
    std::vector<HessianPlanes> hessians;  // [i]: on the picture halved i + 1 times, up to level
  };

  // Row buffers for one band of rows.
  class Workspace;

  static Scale plan_scale(double scale, int width, int height);
  void copy_picture(const Plane<float>& picture);
  static void halve(const PaddedPlane& fine, PaddedPlane& coarse);
  // Row v of the scale's Hessian on the picture halved `level` times, from that picture or from the
  // Hessian on the next smaller one. Three rows of scratch.
  void compute_hessian_row(const Scale& scale, int level, int v, Workspace& scratch, float* sum,
                           float* difference, float* cross) const;
  void compute_coarse_hessians(int level);
  void compute_response(Plane<float>& response) const;

  float ratio_factor_;  // -log2(e) / (2 beta^2): the kernels take powers of two
  float norm_factor_;   // see the response kernel
  std::vector<Scale> scales_;
  std::vector<PaddedPlane> pyramid_;  // [0]: the picture, [i]: halved i times
};

}  // namespace gastronaut::perception

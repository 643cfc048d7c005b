#include "visual_slam/deformation_kernels.hpp"

#include <cstring>

#include "visual_slam/deformation_cholesky.hpp"

// The vectors below never leave this file, so how they would be passed does not matter.
#pragma GCC diagnostic ignored "-Wpsabi"

// Compiled once for each instruction set.
#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "visual_slam/deformation_kernels.cpp"
#include <hwy/foreach_target.h>  // IWYU pragma: keep
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace gastronaut::slam::HWY_NAMESPACE {

// In the compiler's own vectors, without fused operations, like tracking_kernels.cpp.
constexpr int kLanes = 4;
typedef double Lanes __attribute__((vector_size(kLanes * sizeof(double))));
constexpr int kParts = kNodeUnknowns / kLanes;  // of a column
constexpr int kColumnsAtATime = 4;              // as many as registers hold
static_assert(kNodeUnknowns % kLanes == 0 && kNodeUnknowns % kColumnsAtATime == 0);

void subtract_product(const double* a, const double* b, double* c) {
  for (int j = 0; j < kNodeUnknowns; j += kColumnsAtATime) {
    Lanes sum[kColumnsAtATime][kParts] = {};
    for (int k = 0; k < kNodeUnknowns; ++k) {
      Lanes column[kParts];
      std::memcpy(column, a + k * kNodeUnknowns, sizeof column);
      for (int i = 0; i < kColumnsAtATime; ++i) {
        for (int part = 0; part < kParts; ++part) {
          sum[i][part] += column[part] * b[k * kNodeUnknowns + j + i];
        }
      }
    }
    for (int i = 0; i < kColumnsAtATime; ++i) {
      double* target = c + (j + i) * kNodeUnknowns;
      Lanes column[kParts];
      std::memcpy(column, target, sizeof column);
      for (int part = 0; part < kParts; ++part) column[part] -= sum[i][part];
      std::memcpy(target, column, sizeof column);
    }
  }
}

}  // namespace gastronaut::slam::HWY_NAMESPACE
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace gastronaut::slam {

HWY_EXPORT(subtract_product);

void subtract_product(const double* a, const double* b, double* c) {
  HWY_DYNAMIC_DISPATCH(subtract_product)(a, b, c);
}

}  // namespace gastronaut::slam
#endif  // HWY_ONCE

// Any intrinsics: refused, or a model whose rays are rays and, for lenses that could be, whose
// projection undoes its unprojection. No pixel hangs.
#include <fuzzer/FuzzedDataProvider.h>

#include <bit>
#include <cmath>
#include <stdexcept>

#include "camera/camera_model.hpp"
#include "fuzz_check.hpp"

using namespace gastronaut;

namespace {

// A number a lens could have, or any bits at all.
double number(FuzzedDataProvider& data, bool plausible, double low, double high) {
  return plausible ? data.ConsumeFloatingPointInRange(low, high)
                   : std::bit_cast<double>(data.ConsumeIntegral<std::uint64_t>());
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  FuzzedDataProvider data(bytes, size);
  const bool plausible = data.ConsumeBool();
  CameraIntrinsics lens;
  lens.width = plausible ? data.ConsumeIntegralInRange(1, 4096) : data.ConsumeIntegral<int>();
  lens.height = plausible ? data.ConsumeIntegralInRange(1, 4096) : data.ConsumeIntegral<int>();
  lens.fx = number(data, plausible, 10, 5000);
  lens.fy = number(data, plausible, 10, 5000);
  lens.cx = number(data, plausible, 0, 4096);
  lens.cy = number(data, plausible, 0, 4096);
  lens.model = data.ConsumeBool() ? LensModel::kFisheye : LensModel::kRadialTangential;
  const int coefficients = data.ConsumeIntegralInRange(0, 9);
  for (int i = 0; i < coefficients; ++i) {
    lens.distortion.push_back(number(data, plausible, -2, 2));
  }
  try {
    const CameraModel camera(lens);
    const Eigen::Vector2d pixel(number(data, plausible, -100, 5000),
                                number(data, plausible, -100, 5000));
    const auto ray = camera.unproject(pixel);
    if (!ray) return 0;
    promise(ray->allFinite() && std::abs(ray->norm() - 1) < 1e-9, "a ray has unit length");
    // unproject promises 1e-9 in normalised coordinates; a ray's rounding adds to it where the lens
    // is steep, without limit for lenses that are none.
    const double tolerance = 1e-8 * (lens.fx + lens.fy);
    const auto again = camera.project(*ray);
    if (again && plausible) {
      promise((*again - pixel).norm() <= tolerance, "projection undoes unprojection");
    }
    Eigen::Matrix<double, 2, 3> jacobian;
    const Eigen::Vector3d point(number(data, plausible, -1, 1), number(data, plausible, -1, 1),
                                number(data, plausible, -1, 1));
    const auto projected = camera.project(point, jacobian);
    if (projected && plausible) {
      promise(projected->allFinite(), "a projection of a plausible point is a pixel");
    }
  } catch (const std::invalid_argument&) {
  }
  return 0;
}

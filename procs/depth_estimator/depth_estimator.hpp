// What one picture says: metric depth, the wall's albedo with its vessels enhanced, the vessels,
// and how good the picture is.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "configuration/rig_configuration.hpp"
#include "depth_estimator/front_end.hpp"
#include "depth_estimator/shading.hpp"
#include "depth_estimator/shape_from_shading.hpp"
#include "depth_estimator/vessel_filter.hpp"

namespace gastronaut::perception {

struct Perception {
  PictureFailure failure;       // why the picture could not be used
  PinholeGrid grid;             // of depth
  Plane<float> depth;           // metres along the optical axis; 0: none
  double relative_std = 1;      // one sigma of depth as a fraction of it, its common scale included
  Plane<std::uint8_t> albedo;   // see LightDivider::divide; the undistorted picture's pixels
  Plane<std::uint8_t> vessels;  // vessel response, 255 = 1; as albedo
  // All planes are zero where the picture could not be used, empty before the first that could.
  PictureQuality quality;  // zero where the picture could not even be decoded
};

class DepthEstimator {
 public:
  explicit DepthEstimator(const RigConfiguration& configuration);

  // `gain` multiplies camera.exposure_gain; none: the camera does not tell. The result stays valid
  // until the next call. A picture that cannot be used leaves nothing behind for the next one.
  const Perception& estimate(const EncodedPicture& picture, std::optional<double> gain);
  // The same for a picture that is refused before it is looked at.
  const Perception& refuse(const PictureFailure& failure);

 private:
  // What is left of the depth where the shading model explains the light.
  struct Explained {
    double fraction = 0;  // of the pixels
    double std = 0;       // of ln light, what is unexplained among them
  };
  // The albedo where there is no lamp to divide out.
  void take_brightness();
  Explained drop_unexplained(const Plane<float>& log_shading);
  double relative_std(bool gain_known, double unexplained_std) const;

  RigConfiguration configuration_;
  FrontEnd front_end_;
  VesselFilter vessel_filter_;
  LightDivider light_divider_;
  ShapeFromShading shape_from_shading_;
  LinearPicture light_;
  Plane<float> vessels_;
  Shading shading_;
  Perception perception_;
};

}  // namespace gastronaut::perception

// The process depth_estimator: CAMERA in; DEPTH, ALBEDO and VESSELS out, for every picture.
//
// With depth_estimator.depth = sensor another program publishes DEPTH, and there is no lamp on the
// camera to divide out: ALBEDO is the picture's brightness then.
// A picture that cannot be used yields outputs that are zero everywhere, with a relative_std of 1.
// ALBEDO's metadata say which picture it was (seq), how good (sharpness, contrast, mean_level,
// saturated_fraction, dark_fraction, highlight_fraction: PictureQuality) and, where it could not be
// used, why (failure: one word; failure_message: see PictureFailure).
#pragma once

#include <string>

#include "depth_estimator/depth_estimator.hpp"
#include "gastronaut/image_t.hpp"
#include "process/process.hpp"

namespace gastronaut {

class DepthEstimatorProcess : public Process {
 public:
  DepthEstimatorProcess(Bus& bus, const RigConfiguration& configuration);

 private:
  void handle_picture(const image_t& picture);
  void report(const perception::PictureFailure& failure);

  Bus& bus_;
  RigConfiguration configuration_;
  perception::DepthEstimator estimator_;
  std::int64_t pictures_ = 0;
  std::int64_t failures_ = 0;
  std::string last_failure_;
};

ProcessDescription depth_estimator_process();

}  // namespace gastronaut

// The process depth_estimator: CAMERA in; DEPTH, ALBEDO and VESSELS out, for every picture.
//
// A picture that cannot be used yields a DEPTH and an ALBEDO that are zero everywhere; ALBEDO's
// metadata say how good a picture was (sharpness, mean_level, saturated_fraction, dark_fraction,
// highlight_fraction) and, as `failure`, why it could not be used.
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
  void report_problem(const std::string& problem);

  Bus& bus_;
  RigConfiguration configuration_;
  perception::DepthEstimator estimator_;
  std::string problem_;
  std::int64_t failures_ = 0;
};

ProcessDescription depth_estimator_process();

}  // namespace gastronaut

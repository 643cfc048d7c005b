// The process sensor_fusion: MAGNETIC_POSE and VISUAL_POSE in; CAPSULE_STATE and CAPSULE_POSE for
// each of them out. ALBEDO is read for the reasons why vision fails.
//
// CAPSULE_STATE is published for every good message, whatever it says, once a utime: with the utime
// of that message, finite, INITIALISING until the roll about the magnet's axis is known.
#pragma once

#include <cstdint>
#include <string>

#include "gastronaut/image_t.hpp"
#include "gastronaut/magnetic_pose_t.hpp"
#include "gastronaut/visual_pose_t.hpp"
#include "process/process.hpp"
#include "sensor_fusion/failure_cause.hpp"
#include "sensor_fusion/switching_filter.hpp"

namespace gastronaut {

class SensorFusionProcess : public Process {
 public:
  SensorFusionProcess(Bus& bus, const RigConfiguration& configuration);

 private:
  void handle_picture(const image_t& message);
  void handle_magnetic(const magnetic_pose_t& message);
  void handle_visual(const visual_pose_t& message);
  void publish(const fusion::FusedState& state);
  void report(const fusion::FusedState& state);

  Bus& bus_;
  SensorFusionConfiguration configuration_;
  fusion::SwitchingFilter filter_;
  fusion::VisualCause cause_;
};

ProcessDescription sensor_fusion_process();

}  // namespace gastronaut

// A camera's pictures on the bus: CAMERA, as they came if they are JPEG.
#pragma once

#include <cstdint>
#include <string>

#include "bus/bus.hpp"
#include "configuration/rig_configuration.hpp"
#include "uvc_camera/camera.hpp"

namespace gastronaut {

class UvcCameraProcess {
 public:
  UvcCameraProcess(Bus& bus, const RigConfiguration& rig);
  UvcCameraProcess(const UvcCameraProcess&) = delete;
  UvcCameraProcess& operator=(const UvcCameraProcess&) = delete;

  // Metadata: seq, exposure_us and gain (architecture.md), sensor_gain and white_balance in the
  // camera's units; what the camera does not tell is left out.
  void handle(const Picture& picture, const LockedControls& controls);
  // RIG_CONFIG, when it is due.
  void advance(std::int64_t utime);

  struct Health {
    ProcessState state;
    std::string message;
  };
  // How it went since the last call, given all that was counted so far.
  Health report(const CameraCounters& counters, const LockedControls& controls);

 private:
  Bus& bus_;
  RigConfiguration rig_;
  std::int64_t sequence_ = 0;
  std::int64_t last_utime_ = 0;
  std::int64_t configuration_due_ = 0;  // utime
  CameraCounters told_;
};

}  // namespace gastronaut

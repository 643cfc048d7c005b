// A camera whose exposure and colours change by themselves cannot measure depth from light:
// controls are set once and what they are is read back.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "configuration/rig_configuration.hpp"

namespace gastronaut {

enum class CameraControl {
  kAutomaticExposure,      // 0: manual
  kExposureTime,           // 100 microseconds, in UVC and V4L2 alike
  kExposurePriority,       // 0: the frame rate does not change with the exposure
  kGain,                   // in the camera's own units
  kAutomaticWhiteBalance,  // 0: manual
  kWhiteBalance,           // kelvin
  kBacklightCompensation,
};
const char* control_name(CameraControl control);
inline constexpr double kExposureUnit = 1e-4;  // seconds

struct ControlRange {
  int least = 0;
  int most = 0;
  int step = 1;
  int preset = 0;  // the camera's default
};

// The controls of one camera, whichever way they are reached.
class CameraControls {
 public:
  virtual ~CameraControls() = default;
  // Nothing: the camera has no such control, or does not answer.
  virtual std::optional<int> get(CameraControl control) = 0;
  virtual std::optional<ControlRange> range(CameraControl control) = 0;
  virtual bool set(CameraControl control, int value) = 0;
};

struct LockedControls {
  std::optional<double> exposure;     // seconds, as read back
  std::optional<int> gain;            // the camera's units
  std::optional<int> white_balance;   // kelvin
  std::vector<std::string> problems;  // what could not be locked, or was set to something else
};

// Ends the camera's automatic control and sets what is asked for; what is not asked for stays as
// the camera has it at this moment.
LockedControls lock_controls(CameraControls& controls, const UvcCameraConfiguration& wanted);

// A line for each control that the camera has: value and range.
std::vector<std::string> describe_controls(CameraControls& controls);

}  // namespace gastronaut

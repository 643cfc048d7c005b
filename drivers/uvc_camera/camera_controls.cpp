#include "uvc_camera/camera_controls.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace gastronaut {
namespace {

constexpr CameraControl kAll[] = {
    CameraControl::kAutomaticExposure,     CameraControl::kExposureTime,
    CameraControl::kExposurePriority,      CameraControl::kGain,
    CameraControl::kAutomaticWhiteBalance, CameraControl::kWhiteBalance,
    CameraControl::kBacklightCompensation};

class Lock {
 public:
  explicit Lock(CameraControls& controls) : controls_(controls) {}

  void switch_off(CameraControl control, const std::string& consequence) {
    const std::optional<int> is = controls_.get(control);
    if (!is || *is == 0) return;  // a camera without the control has nothing that changes
    if (controls_.set(control, 0) && controls_.get(control).value_or(1) == 0) return;
    problem(fmt::format("{} cannot be switched off: {}", control_name(control), consequence));
  }

  // Sets, where asked to; what the control then is.
  std::optional<int> fix(CameraControl control, std::optional<int> wanted) {
    if (!wanted) return controls_.get(control);
    const std::optional<ControlRange> range = controls_.range(control);
    if (!range) {
      problem(fmt::format("this camera has no {}", control_name(control)));
      return std::nullopt;
    }
    const int nearest = range->least + (std::clamp(*wanted, range->least, range->most) -
                                        range->least + range->step / 2) /
                                           range->step * range->step;
    controls_.set(control, std::min(nearest, range->most));
    const std::optional<int> is = controls_.get(control);
    if (is != wanted) {
      problem(fmt::format("{} is {} instead of {} (the camera offers {} to {} in steps of {})",
                          control_name(control), is ? std::to_string(*is) : "unknown", *wanted,
                          range->least, range->most, range->step));
    }
    return is;
  }

  void problem(const std::string& text) { problems_.push_back(text); }
  std::vector<std::string> take_problems() { return std::move(problems_); }

 private:
  CameraControls& controls_;
  std::vector<std::string> problems_;
};

}  // namespace

const char* control_name(CameraControl control) {
  switch (control) {
    case CameraControl::kAutomaticExposure:
      return "automatic exposure";
    case CameraControl::kExposureTime:
      return "exposure time (100 us)";
    case CameraControl::kExposurePriority:
      return "frame rate that changes with the exposure";
    case CameraControl::kGain:
      return "gain";
    case CameraControl::kAutomaticWhiteBalance:
      return "automatic white balance";
    case CameraControl::kWhiteBalance:
      return "white balance (K)";
    case CameraControl::kBacklightCompensation:
      return "backlight compensation";
  }
  return "";
}

LockedControls lock_controls(CameraControls& controls, const UvcCameraConfiguration& wanted) {
  Lock lock(controls);
  lock.switch_off(CameraControl::kExposurePriority, "the frame rate may change");
  lock.switch_off(CameraControl::kAutomaticExposure,
                  "depth from the light is wrong by its changes");
  lock.switch_off(CameraControl::kAutomaticWhiteBalance, "colours change");
  lock.switch_off(CameraControl::kBacklightCompensation, "the brightness of a point may change");
  LockedControls locked;
  const auto units = [](double seconds) {
    return static_cast<int>(std::lround(seconds / kExposureUnit));
  };
  if (const auto exposure =
          lock.fix(CameraControl::kExposureTime,
                   wanted.exposure > 0 ? std::optional(units(wanted.exposure)) : std::nullopt)) {
    locked.exposure = *exposure * kExposureUnit;
  }
  locked.gain =
      lock.fix(CameraControl::kGain, wanted.gain >= 0 ? std::optional(wanted.gain) : std::nullopt);
  locked.white_balance =
      lock.fix(CameraControl::kWhiteBalance,
               wanted.white_balance > 0 ? std::optional(wanted.white_balance) : std::nullopt);
  locked.problems = lock.take_problems();
  return locked;
}

std::vector<std::string> describe_controls(CameraControls& controls) {
  std::vector<std::string> lines;
  for (const CameraControl control : kAll) {
    const std::optional<int> value = controls.get(control);
    if (!value) continue;
    std::string line = fmt::format("{}: {}", control_name(control), *value);
    if (const auto range = controls.range(control)) {
      line += fmt::format(" ({} to {} in steps of {}, default {})", range->least, range->most,
                          range->step, range->preset);
    }
    lines.push_back(line);
  }
  return lines;
}

}  // namespace gastronaut

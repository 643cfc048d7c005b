#include "uvc_camera/uvc_camera_process.hpp"

#include <fmt/format.h>

#include <cmath>
#include <gastronaut/image_t.hpp>

#include "process/channels.hpp"
#include "process/rig_config_message.hpp"

namespace gastronaut {
namespace {

constexpr std::int64_t kConfigurationPeriod = 10'000'000;  // microseconds between RIG_CONFIG
constexpr std::int64_t kClockStep = 1'000'000;             // microseconds: the clock was set

image_metadata_t metadata(const std::string& key, const std::string& value) {
  image_metadata_t entry;
  entry.key = key;
  entry.value.assign(value.begin(), value.end());
  entry.n = static_cast<std::int32_t>(entry.value.size());
  return entry;
}

}  // namespace

UvcCameraProcess::UvcCameraProcess(Bus& bus, const RigConfiguration& rig) : bus_(bus), rig_(rig) {}

void UvcCameraProcess::handle(const Picture& picture, const LockedControls& controls) {
  advance(picture.utime);
  image_t message;
  message.utime = picture.utime;
  // Two pictures never have the same time, whatever the camera's clock does.
  if (message.utime <= last_utime_ && message.utime > last_utime_ - kClockStep) {
    message.utime = last_utime_ + 1;
  }
  last_utime_ = message.utime;
  message.width = picture.width;
  message.height = picture.height;
  message.row_stride = 0;
  message.pixelformat = image_t::PIXEL_FORMAT_MJPEG;
  message.data = picture.encoding == PictureEncoding::kMjpeg ? picture.data : encode_jpeg(picture);
  message.size = static_cast<std::int32_t>(message.data.size());
  message.metadata = {metadata("seq", std::to_string(sequence_++))};
  if (controls.exposure) {
    constexpr double kMicroseconds = 1e6;
    message.metadata.push_back(
        metadata("exposure_us", std::to_string(std::llround(*controls.exposure * kMicroseconds))));
    const double calibrated = rig_.uvc_camera.calibrated_exposure > 0
                                  ? rig_.uvc_camera.calibrated_exposure
                                  : rig_.uvc_camera.exposure;
    if (calibrated > 0) {
      message.metadata.push_back(
          metadata("gain", fmt::format("{}", *controls.exposure / calibrated)));
    }
  }
  const auto add = [&message](const char* key, std::optional<int> value) {
    if (value) message.metadata.push_back(metadata(key, std::to_string(*value)));
  };
  add("sensor_gain", controls.gain);
  add("white_balance", controls.white_balance);
  message.nmetadata = static_cast<std::int32_t>(message.metadata.size());
  bus_.publish(channel::kCamera, message);
}

void UvcCameraProcess::advance(std::int64_t utime) {
  const bool clock_was_set_back = utime < configuration_due_ - kConfigurationPeriod;
  if (utime < configuration_due_ && !clock_was_set_back) return;
  bus_.publish(channel::kRigConfig, rig_config_message(rig_, utime));
  configuration_due_ = utime + kConfigurationPeriod;
}

UvcCameraProcess::Health UvcCameraProcess::report(const CameraCounters& counters,
                                                  const LockedControls& controls) {
  std::string text;
  const auto add = [&text](const std::string& more) { text += (text.empty() ? "" : "; ") + more; };
  if (counters.pictures == told_.pictures) add("no picture comes");
  if (counters.damaged > told_.damaged) {
    add(std::to_string(counters.damaged - told_.damaged) +
        " pictures were damaged and left out; try another cable or port, or a lower rate");
  }
  if (counters.lost > told_.lost) {
    add(std::to_string(counters.lost - told_.lost) +
        " pictures were lost in the kernel: damaged, or not taken in time");
  }
  told_ = counters;
  for (const std::string& problem : controls.problems) add(problem);
  return {text.empty() ? ProcessState::kRunning : ProcessState::kDegraded, text};
}

}  // namespace gastronaut

// What a USB camera says of itself: the configuration descriptor of a device of the USB Video Class
// (UVC 1.0, 1.1 and 1.5; "USB Device Class Definition for Video Devices", chapter 3).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace gastronaut {

// dwFrameInterval and its like count these.
inline constexpr double kUvcTick = 1e-7;  // seconds

struct UvcFrameSize {
  int index = 0;  // bFrameIndex, from 1
  int width = 0;  // pixels
  int height = 0;
  std::uint32_t default_interval = 0;  // ticks
  // Either these intervals, or every `step` from `shortest` to `longest`.
  std::vector<std::uint32_t> intervals;
  std::uint32_t shortest = 0;
  std::uint32_t longest = 0;
  std::uint32_t step = 0;

  // Of the offered intervals the one nearest to `seconds`.
  std::uint32_t nearest_interval(double seconds) const;
};

enum class UvcEncoding { kMjpeg, kYuyv, kOther };

struct UvcFormat {
  int index = 0;  // bFormatIndex, from 1
  UvcEncoding encoding = UvcEncoding::kOther;
  std::string name;  // "MJPEG", else the four characters of its GUID: "YUY2", "NV12", "H264"
  int bits_per_pixel = 0;
  std::vector<UvcFrameSize> sizes;
};

// Of a streaming interface: a setting to be chosen with the bandwidth that it has.
struct UvcAlternate {
  int setting = 0;
  std::uint8_t endpoint = 0;
  bool isochronous = false;
  // Bytes a service interval (isochronous, with its multiplier or burst) or a packet (bulk).
  int bytes = 0;
};

struct UvcStream {
  int interface = 0;
  std::uint8_t endpoint = 0;
  std::vector<UvcFormat> formats;
  std::vector<UvcAlternate> alternates;

  bool is_isochronous() const;
  // The narrowest isochronous setting that carries `bytes` a service interval, else the widest.
  // Throws std::runtime_error if there is none at all.
  const UvcAlternate& alternate_for(std::uint32_t bytes) const;
};

// Bits of bmControls of the camera terminal and of the processing unit.
enum class UvcTerminalControl {
  kExposureMode = 1,
  kExposurePriority = 2,
  kExposureTime = 3,
  kFocus = 5,
  kFocusAuto = 17
};
enum class UvcProcessingControl {
  kBrightness = 0,
  kBacklightCompensation = 8,
  kGain = 9,
  kPowerLineFrequency = 10,
  kWhiteBalanceTemperature = 6,
  kWhiteBalanceTemperatureAuto = 12
};

// One camera: a video control interface with its streams. A device may hold several.
struct UvcFunction {
  int interface = 0;           // of video control
  int version = 0;             // bcdUVC: 0x0100, 0x0110, 0x0150
  double clock_frequency = 0;  // Hz, of the time stamps in payloads
  int camera_terminal = 0;     // its bTerminalID; 0: none
  int processing_unit = 0;     // its bUnitID; 0: none
  std::uint32_t terminal_controls = 0;
  std::uint32_t processing_controls = 0;
  std::vector<UvcStream> streams;

  bool has(UvcTerminalControl control) const;
  bool has(UvcProcessingControl control) const;
};

// All cameras in a configuration descriptor, in its order; none for a device that is no camera.
// Descriptors of other classes and kinds are passed over. Throws std::runtime_error that says what
// is cut short or impossible.
std::vector<UvcFunction> parse_uvc_descriptors(std::span<const std::uint8_t> bytes);

}  // namespace gastronaut

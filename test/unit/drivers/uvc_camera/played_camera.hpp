// The device's side of the USB Video Class, for tests: descriptors, requests, and pictures as
// payloads. Written from UVC 1.1 and USB 2.0 (chapter 9), without a line of the driver's.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <span>
#include <vector>

namespace gastronaut {

using Octets = std::vector<std::uint8_t>;

class PlayedCamera {
 public:
  static constexpr int kVendor = 0x1209;  // pid.codes, for tests: product 0001
  static constexpr int kProduct = 0x0001;
  static constexpr const char* kSerial = "PLAYED-7";
  static constexpr std::uint8_t kEndpoint = 0x81;
  static constexpr std::uint32_t kClockFrequency = 1'000'000;
  static constexpr std::uint32_t kBulkPayload = 16384;
  // MJPEG is format 1, YUY2 format 2; both in these sizes, frames 1 to 3.
  static constexpr int kSizes[3][2] = {{320, 240}, {640, 480}, {160, 120}};

  explicit PlayedCamera(bool is_isochronous);

  Octets device_descriptor() const;
  Octets configuration_descriptor() const;

  // A request to the control pipe: what the device answers (empty for OUT), or nothing: it stalls.
  struct Setup {
    std::uint8_t type = 0;
    std::uint8_t request = 0;
    std::uint16_t value = 0;
    std::uint16_t index = 0;
    std::uint16_t length = 0;
  };
  std::optional<Octets> answer(const Setup& setup, std::span<const std::uint8_t> data);

  bool is_isochronous() const { return is_isochronous_; }
  // Whether the host has asked for pictures: by a setting with bandwidth, or (bulk) by a commit.
  bool is_streaming() const { return is_streaming_; }
  int width() const { return kSizes[probe_.frame - 1][0]; }
  int height() const { return kSizes[probe_.frame - 1][1]; }
  bool is_mjpeg() const { return probe_.format == 1; }
  double interval() const;    // seconds between pictures, as committed
  int payload_bytes() const;  // the longest payload
  // Manual exposure (100 us), gain, white balance as set; automatic modes.
  int control(int unit, int selector) const { return controls_.at({unit, selector}).value; }

  struct Faults {
    bool has_error = false;       // one payload with the error mark
    double kept_share = 1;        // of the picture's bytes: the rest is never sent
    bool is_end_missing = false;  // no end mark: the next identifier tells
  };
  // A picture as payloads with headers; `begin` and `sent` on the camera's clock.
  std::vector<Octets> payloads(std::span<const std::uint8_t> picture, std::uint32_t begin,
                               std::uint32_t sent, const Faults& faults);

 private:
  struct Control {
    std::size_t bytes;
    int value;
    int least;
    int most;
    int preset;
  };
  struct Probe {
    std::uint8_t format = 1;
    std::uint8_t frame = 1;
    std::uint32_t interval = 0;
  };
  std::optional<Octets> answer_standard(const Setup& setup) const;
  std::optional<Octets> answer_control(const Setup& setup, std::span<const std::uint8_t> data);
  std::optional<Octets> answer_stream(const Setup& setup, std::span<const std::uint8_t> data);

  bool is_isochronous_;
  bool is_streaming_ = false;
  int alternate_ = 0;
  bool identifier_ = false;
  Probe probe_;
  std::map<std::pair<int, int>, Control> controls_;  // by unit and selector
};

}  // namespace gastronaut

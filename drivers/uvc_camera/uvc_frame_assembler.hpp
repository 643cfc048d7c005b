// Pictures out of the payloads that a UVC camera sends (UVC 1.5, 2.4.3.3): each has a header with a
// frame identifier that toggles, an end mark, an error mark and the camera's clock.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "clock/device_clock.hpp"

namespace gastronaut {

struct UvcFrame {
  std::vector<std::uint8_t> data;
  std::int64_t arrival = 0;             // utime of its first payload
  std::optional<std::int64_t> capture;  // utime of its exposure's begin, where the camera tells
  bool is_ended = false;                // with an end mark; without, the next frame had begun
};

class UvcFrameAssembler {
 public:
  struct Settings {
    std::size_t largest_frame = 0;    // bytes, dwMaxVideoFrameSize
    std::size_t largest_payload = 0;  // bytes, dwMaxPayloadTransferSize: where a bulk payload ends
    double clock_frequency = 0;       // Hz, of the camera's clock; 0: it has none
  };
  struct Counters {
    std::int64_t frames = 0;     // handed on
    std::int64_t damaged = 0;    // with the camera's error mark, or a packet that did not arrive
    std::int64_t oversized = 0;  // larger than announced
    std::int64_t malformed = 0;  // payloads without a header
  };
  using Sink = std::function<void(UvcFrame)>;

  // `sink` gets frames without error mark; whether a picture is in them is for the sink to judge.
  UvcFrameAssembler(const Settings& settings, Sink sink);

  // One isochronous packet, or a whole bulk payload, that had arrived by `utime`.
  void add_payload(std::span<const std::uint8_t> payload, std::int64_t utime);
  // A bulk transfer: a payload, or a part of one. A short transfer (less than was asked for) ends
  // it.
  void add_bulk_transfer(std::span<const std::uint8_t> data, bool is_short, std::int64_t utime);
  // The bus lost something: what is being put together is damaged.
  void add_loss();

  const Counters& counters() const { return counters_; }

 private:
  bool take_header(std::span<const std::uint8_t> payload, std::int64_t utime);
  void take_clock(std::span<const std::uint8_t> header, std::int64_t utime);
  void take_data(std::span<const std::uint8_t> data);
  void end_frame(bool is_ended);

  Settings settings_;
  Sink sink_;
  Counters counters_;
  UvcFrame frame_;
  bool has_begun_ = false;  // a frame, with or without data so far
  bool is_damaged_ = false;
  bool is_oversized_ = false;
  std::optional<bool> identifier_;  // of the frame that is being put together or has just ended
  bool ends_frame_ = false;         // the payload under way has the end mark
  std::size_t payload_bytes_ = 0;   // of the bulk payload under way, header included
  bool drops_payload_ = false;      // it has no header that could be read
  // The camera's clock, 32 bits of it on the wire.
  std::optional<std::uint32_t> last_ticks_;
  std::int64_t ticks_ = 0;
  DeviceClock clock_;
};

}  // namespace gastronaut

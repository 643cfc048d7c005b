// One frame on a CAN bus, classic or FD, whatever it came from: a socket, a recorded log, a test.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <span>

namespace gastronaut {

inline constexpr std::size_t kClassicCanBytes = 8;
inline constexpr std::size_t kMostCanBytes = 64;

struct CanFrame {
  std::uint32_t id = 0;   // without flags; of an error frame: its error classes (linux/can/error.h)
  bool extended = false;  // 29 bits of identifier, not 11
  bool remote = false;
  bool error = false;  // made by the controller's driver: tells of the bus, not from it
  bool fd = false;
  bool bit_rate_switch = false;
  std::uint8_t length = 0;  // bytes of data
  std::array<std::uint8_t, kMostCanBytes> data{};
  std::int64_t utime = 0;  // microseconds since the epoch, when it was received

  std::span<const std::uint8_t> bytes() const { return {data.data(), length}; }
  bool operator==(const CanFrame&) const = default;
};

// The shortest length that a CAN frame can have for `bytes` of data (above 8 FD knows 12, 16, 20,
// 24, 32, 48 and 64 only). `bytes` up to 64.
constexpr std::uint8_t can_frame_length(std::size_t bytes) {
  if (bytes <= kClassicCanBytes) return static_cast<std::uint8_t>(bytes);
  for (const std::size_t length : {12U, 16U, 20U, 24U, 32U, 48U}) {
    if (bytes <= length) return static_cast<std::uint8_t>(length);
  }
  return kMostCanBytes;
}

}  // namespace gastronaut

#include "can/candump.hpp"

#include <linux/can.h>
#include <spdlog/fmt/fmt.h>

#include <charconv>
#include <stdexcept>

namespace gastronaut {
namespace {

constexpr int kMicrosecondDigits = 6;
constexpr std::size_t kStandardDigits = 3;
constexpr std::size_t kExtendedDigits = 8;

[[noreturn]] void fail(const char* problem) { throw std::invalid_argument(problem); }

template <class Number>
Number number(std::string_view text, int base, const char* problem) {
  Number value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value, base);
  if (error != std::errc() || end != text.data() + text.size()) fail(problem);
  return value;
}

// Takes everything up to `end` off the front of `text`, and `end` with it.
std::string_view take_until(std::string_view& text, char end, const char* problem) {
  const std::size_t at = text.find(end);
  if (at == std::string_view::npos) fail(problem);
  const std::string_view taken = text.substr(0, at);
  text.remove_prefix(at + 1);
  return taken;
}

// Seconds with up to nine digits of fraction, exactly.
std::int64_t microseconds(std::string_view text) {
  constexpr const char* kProblem = "no time in seconds, such as (1618787934.854636)";
  constexpr std::int64_t kMostSeconds = 4'000'000'000'000;  // as microseconds they fit 64 bits
  const std::string_view seconds = take_until(text, '.', kProblem);
  const auto whole = number<std::uint64_t>(seconds, 10, kProblem);
  if (whole > kMostSeconds || text.empty()) fail(kProblem);
  const auto fraction = number<std::uint32_t>(text, 10, kProblem);
  std::int64_t scaled = fraction;
  for (std::size_t digits = text.size(); digits < kMicrosecondDigits; ++digits) scaled *= 10;
  for (std::size_t digits = text.size(); digits > kMicrosecondDigits; --digits) scaled /= 10;
  return static_cast<std::int64_t>(whole) * 1'000'000 + scaled;
}

void read_identifier(std::string_view text, CanFrame& frame) {
  const auto id = number<std::uint32_t>(text, 16, "no CAN identifier of 3 or 8 digits before #");
  if (text.size() == kStandardDigits) {
    if (id > CAN_SFF_MASK) fail("an identifier of 3 digits is at most 7FF");
    frame.id = id;
  } else if (text.size() == kExtendedDigits) {
    frame.error = (id & CAN_ERR_FLAG) != 0;
    if (!frame.error && id > CAN_EFF_MASK) fail("an identifier of 8 digits is at most 1FFFFFFF");
    frame.extended = !frame.error;
    frame.id = id & CAN_EFF_MASK;
  } else {
    fail("no CAN identifier of 3 or 8 digits before #");
  }
}

void read_data(std::string_view text, CanFrame& frame) {
  const std::size_t most = frame.fd ? kMostCanBytes : kClassicCanBytes;
  if (text.size() % 2 != 0) fail("data must be pairs of hexadecimal digits");
  if (text.size() / 2 > most) {
    fail(frame.fd ? "a CAN FD frame has at most 64 bytes" : "a classic frame has at most 8 bytes");
  }
  frame.length = static_cast<std::uint8_t>(text.size() / 2);
  for (std::size_t i = 0; i < frame.length; ++i) {
    frame.data[i] =
        number<std::uint8_t>(text.substr(2 * i, 2), 16, "data must be pairs of hexadecimal digits");
  }
  if (frame.fd && can_frame_length(frame.length) != frame.length) {
    fail("a CAN FD frame cannot have this length");
  }
}

void read_payload(std::string_view text, CanFrame& frame) {
  if (!text.empty() && text.front() == '#') {
    frame.fd = true;
    if (text.size() < 2) fail("a CAN FD frame without its flags");
    const auto flags = number<std::uint8_t>(text.substr(1, 1), 16, "no digit of flags after ##");
    frame.bit_rate_switch = (flags & CANFD_BRS) != 0;
    return read_data(text.substr(2), frame);
  }
  // A data length code above 8 is not of interest.
  text = text.substr(0, text.find('_'));
  if (!text.empty() && text.front() == 'R') {
    frame.remote = true;
    if (text.size() > 1) {
      frame.length = number<std::uint8_t>(text.substr(1), 16, "no length after R");
      if (frame.length > kClassicCanBytes) fail("a classic frame has at most 8 bytes");
    }
    return;
  }
  read_data(text, frame);
}

}  // namespace

CandumpLine parse_candump_line(std::string_view line) {
  while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.remove_suffix(1);
  if (line.empty() || line.front() != '(') fail("a line must begin with (time)");
  line.remove_prefix(1);
  CandumpLine parsed;
  parsed.frame.utime = microseconds(take_until(line, ')', "no ) after the time"));
  if (line.empty() || line.front() != ' ') fail("no space after the time");
  line.remove_prefix(1);
  parsed.interface = take_until(line, ' ', "no interface after the time");
  if (parsed.interface.empty()) fail("no interface after the time");
  // `candump -x` adds the direction.
  if (line.ends_with(" R") || line.ends_with(" T")) line.remove_suffix(2);
  read_identifier(take_until(line, '#', "no # between identifier and data"), parsed.frame);
  read_payload(line, parsed.frame);
  return parsed;
}

std::string format_candump_line(const CandumpLine& line) {
  const CanFrame& frame = line.frame;
  const std::uint32_t id = frame.id | (frame.error ? CAN_ERR_FLAG : 0U);
  std::string text =
      fmt::format("({:010}.{:06}) {} ", frame.utime / 1'000'000, frame.utime % 1'000'000,
                  line.interface) +
      (frame.extended || frame.error ? fmt::format("{:08X}#", id) : fmt::format("{:03X}#", id));
  if (frame.fd) text += frame.bit_rate_switch ? "#1" : "#0";
  if (frame.remote) return text + "R" + (frame.length > 0 ? fmt::format("{:X}", frame.length) : "");
  for (const std::uint8_t byte : frame.bytes()) text += fmt::format("{:02X}", byte);
  return text;
}

}  // namespace gastronaut

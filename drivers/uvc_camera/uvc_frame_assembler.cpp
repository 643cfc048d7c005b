#include "uvc_camera/uvc_frame_assembler.hpp"

#include <cmath>
#include <utility>

namespace gastronaut {
namespace {

// bmHeaderInfo.
constexpr int kFrameIdentifier = 0x01;
constexpr int kEndOfFrame = 0x02;
constexpr int kPresentationTime = 0x04;
constexpr int kSourceClock = 0x08;
constexpr int kError = 0x40;
constexpr std::size_t kLeastHeader = 2;
constexpr double kMicrosecondsPerSecond = 1e6;

std::uint32_t read_dword(std::span<const std::uint8_t> bytes) {
  return static_cast<std::uint32_t>(bytes[0]) | static_cast<std::uint32_t>(bytes[1]) << 8 |
         static_cast<std::uint32_t>(bytes[2]) << 16 | static_cast<std::uint32_t>(bytes[3]) << 24;
}

}  // namespace

UvcFrameAssembler::UvcFrameAssembler(const Settings& settings, Sink sink)
    : settings_(settings), sink_(std::move(sink)) {}

void UvcFrameAssembler::add_payload(std::span<const std::uint8_t> payload, std::int64_t utime) {
  if (payload.empty()) return;  // the camera had nothing to send in this interval
  if (!take_header(payload, utime)) return;
  take_data(payload.subspan(payload[0]));
  if (ends_frame_) end_frame(true);
}

void UvcFrameAssembler::add_bulk_transfer(std::span<const std::uint8_t> data, bool is_short,
                                          std::int64_t utime) {
  if (payload_bytes_ == 0 && !data.empty()) {
    drops_payload_ = !take_header(data, utime);
    if (!drops_payload_) take_data(data.subspan(data[0]));
  } else if (!drops_payload_) {
    take_data(data);
  }
  payload_bytes_ += data.size();
  if (!is_short && payload_bytes_ < settings_.largest_payload) return;
  const bool ends = payload_bytes_ > 0 && !drops_payload_ && ends_frame_;
  payload_bytes_ = 0;
  drops_payload_ = false;
  if (ends) end_frame(true);
}

void UvcFrameAssembler::add_loss() {
  if (has_begun_) is_damaged_ = true;
}

bool UvcFrameAssembler::take_header(std::span<const std::uint8_t> payload, std::int64_t utime) {
  const std::size_t length = payload[0];
  const int info = payload.size() < kLeastHeader ? 0 : payload[1];
  const std::size_t needed = kLeastHeader + ((info & kPresentationTime) != 0 ? 4u : 0u) +
                             ((info & kSourceClock) != 0 ? 6u : 0u);
  if (length < needed || length > payload.size()) {
    ++counters_.malformed;
    add_loss();
    return false;
  }
  const bool identifier = (info & kFrameIdentifier) != 0;
  if (identifier_ != identifier) {
    if (has_begun_) end_frame(false);
    identifier_ = identifier;
    has_begun_ = true;
    frame_.arrival = utime;
  } else if (!has_begun_) {
    // After the end mark: nothing but fill may follow under the same identifier.
    ends_frame_ = false;
    return true;
  }
  ends_frame_ = (info & kEndOfFrame) != 0;
  if ((info & kError) != 0) is_damaged_ = true;
  take_clock(payload.first(length), utime);
  return true;
}

// PTS is when the exposure began, SCR what the camera's clock showed when the payload went out.
void UvcFrameAssembler::take_clock(std::span<const std::uint8_t> header, std::int64_t utime) {
  if (settings_.clock_frequency <= 0 || (header[1] & kSourceClock) == 0) return;
  const bool has_time = (header[1] & kPresentationTime) != 0;
  const std::uint32_t source = read_dword(header.subspan(has_time ? 6 : 2));
  // Differences of 32 bits go around with the counter.
  if (last_ticks_) ticks_ += static_cast<std::int32_t>(source - *last_ticks_);
  last_ticks_ = source;
  const double microseconds_per_tick = kMicrosecondsPerSecond / settings_.clock_frequency;
  const auto microseconds = [&](std::int64_t ticks) {
    return std::llround(static_cast<double>(ticks) * microseconds_per_tick);
  };
  const std::int64_t sent = clock_.to_host(microseconds(ticks_), utime);
  if (!has_time || frame_.capture) return;
  const auto ago = static_cast<std::int32_t>(source - read_dword(header.subspan(2)));
  // Some cameras' time stamps are not of the clock that they announce.
  constexpr double kLongestAgo = 1;  // seconds
  if (ago < 0 || ago > kLongestAgo * settings_.clock_frequency) return;
  frame_.capture = sent - microseconds(ago);
}

void UvcFrameAssembler::take_data(std::span<const std::uint8_t> data) {
  if (!has_begun_) return;
  if (frame_.data.size() + data.size() > settings_.largest_frame) {
    is_oversized_ = true;
    return;
  }
  frame_.data.insert(frame_.data.end(), data.begin(), data.end());
}

void UvcFrameAssembler::end_frame(bool is_ended) {
  UvcFrame frame = std::exchange(frame_, {});
  const bool is_damaged = std::exchange(is_damaged_, false);
  const bool is_oversized = std::exchange(is_oversized_, false);
  has_begun_ = false;
  ends_frame_ = false;
  if (is_damaged) {
    ++counters_.damaged;
  } else if (is_oversized) {
    ++counters_.oversized;
  } else if (!frame.data.empty()) {
    ++counters_.frames;
    frame.is_ended = is_ended;
    sink_(std::move(frame));
  }
}

}  // namespace gastronaut

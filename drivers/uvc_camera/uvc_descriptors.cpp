#include "uvc_camera/uvc_descriptors.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

namespace gastronaut {
namespace {

// bDescriptorType, bInterfaceSubClass and bDescriptorSubType (UVC 1.5, appendix A).
constexpr int kInterface = 0x04;
constexpr int kEndpoint = 0x05;
constexpr int kClassSpecificInterface = 0x24;
constexpr int kSuperSpeedCompanion = 0x30;
constexpr int kVideoClass = 0x0e;
constexpr int kControlSubclass = 1;
constexpr int kStreamingSubclass = 2;
constexpr int kControlHeader = 1;
constexpr int kInputTerminal = 2;
constexpr int kProcessingUnit = 5;
constexpr int kCameraTerminalType = 0x0201;
constexpr int kInputHeader = 1;
constexpr int kFormatUncompressed = 4;
constexpr int kFrameUncompressed = 5;
constexpr int kFormatMjpeg = 6;
constexpr int kFrameMjpeg = 7;
constexpr int kFormatFrameBased = 16;
constexpr int kFrameFrameBased = 17;
// bmAttributes of an endpoint.
constexpr int kTransferType = 3;
constexpr int kIsochronous = 1;
constexpr int kBulk = 2;

// One descriptor; reading past its end is an error with its place.
class Descriptor {
 public:
  Descriptor(std::span<const std::uint8_t> bytes, std::size_t place)
      : bytes_(bytes), place_(place) {}

  int type() const { return byte(1); }
  int byte(std::size_t at) const { return bytes(at, 1)[0]; }
  int word(std::size_t at) const {
    const auto b = bytes(at, 2);
    return b[0] | b[1] << 8;
  }
  std::uint32_t dword(std::size_t at) const {
    return static_cast<std::uint32_t>(word(at)) | static_cast<std::uint32_t>(word(at + 2)) << 16;
  }
  // Little-endian, up to four bytes of `count`: bitmaps may have any length.
  std::uint32_t bits(std::size_t at, std::size_t count) const {
    const auto b = bytes(at, count);
    std::uint32_t value = 0;
    for (std::size_t i = 0; i < std::min<std::size_t>(count, 4); ++i) {
      value |= static_cast<std::uint32_t>(b[i]) << (8 * i);
    }
    return value;
  }
  std::span<const std::uint8_t> bytes(std::size_t at, std::size_t count) const {
    if (at + count > bytes_.size()) {
      throw std::runtime_error(fmt::format(
          "USB descriptor at byte {} (type {:#x}) is cut short: {} bytes, at least {} needed",
          place_, bytes_.size() > 1 ? bytes_[1] : 0, bytes_.size(), at + count));
    }
    return bytes_.subspan(at, count);
  }

 private:
  std::span<const std::uint8_t> bytes_;
  std::size_t place_;
};

class Parser {
 public:
  void take(const Descriptor& descriptor) {
    switch (descriptor.type()) {
      case kInterface:
        return take_interface(descriptor);
      case kClassSpecificInterface:
        if (subclass_ == kControlSubclass) take_control(descriptor);
        if (subclass_ == kStreamingSubclass) take_streaming(descriptor);
        return;
      case kEndpoint:
        if (subclass_ == kStreamingSubclass) take_endpoint(descriptor);
        return;
      case kSuperSpeedCompanion:
        if (subclass_ == kStreamingSubclass) take_companion(descriptor);
        return;
      default:
        return;
    }
  }
  std::vector<UvcFunction> take_result() { return std::move(functions_); }

 private:
  void take_interface(const Descriptor& d) {
    subclass_ = d.byte(5) == kVideoClass ? d.byte(6) : 0;
    const int interface = d.byte(2);
    setting_ = d.byte(3);
    if (subclass_ == kControlSubclass) {
      functions_.emplace_back().interface = interface;
    } else if (subclass_ == kStreamingSubclass) {
      if (functions_.empty()) throw std::runtime_error("video streaming without video control");
      auto& streams = functions_.back().streams;
      if (streams.empty() || streams.back().interface != interface) {
        streams.emplace_back().interface = interface;
      }
    }
  }

  void take_control(const Descriptor& d) {
    UvcFunction& function = functions_.back();
    const int kind = d.byte(2);
    if (kind == kControlHeader) {
      function.version = d.word(3);
      function.clock_frequency = d.dword(7);
    } else if (kind == kInputTerminal && d.word(4) == kCameraTerminalType) {
      function.camera_terminal = d.byte(3);
      function.terminal_controls = d.bits(15, static_cast<std::size_t>(d.byte(14)));
    } else if (kind == kProcessingUnit) {
      function.processing_unit = d.byte(3);
      function.processing_controls = d.bits(8, static_cast<std::size_t>(d.byte(7)));
    }
  }

  UvcStream& stream() { return functions_.back().streams.back(); }

  void take_streaming(const Descriptor& d) {
    switch (d.byte(2)) {
      case kInputHeader:
        stream().endpoint = static_cast<std::uint8_t>(d.byte(6));
        return;
      case kFormatMjpeg:
        stream().formats.push_back({d.byte(3), UvcEncoding::kMjpeg, "MJPEG", 0, {}});
        return;
      case kFormatUncompressed:
      case kFormatFrameBased: {
        const auto guid = d.bytes(5, 16);
        std::string name;
        for (const std::uint8_t character : guid.first(4)) {
          name += character > ' ' && character < 0x7f ? static_cast<char>(character) : '?';
        }
        const UvcEncoding encoding = name == "YUY2" ? UvcEncoding::kYuyv : UvcEncoding::kOther;
        stream().formats.push_back({d.byte(3), encoding, name, d.byte(21), {}});
        return;
      }
      case kFrameMjpeg:
      case kFrameUncompressed:
        return take_frame(d, 21, 25);
      case kFrameFrameBased:
        return take_frame(d, 17, 21);
      default:
        return;
    }
  }

  // `interval`, `kind`: where dwDefaultFrameInterval and bFrameIntervalType stand.
  void take_frame(const Descriptor& d, std::size_t interval, std::size_t kind) {
    if (stream().formats.empty()) throw std::runtime_error("a frame size before its format");
    UvcFrameSize size;
    size.index = d.byte(3);
    size.width = d.word(5);
    size.height = d.word(7);
    size.default_interval = d.dword(interval);
    constexpr std::size_t first =
        26;  // dwFrameInterval; a frame-based one has dwBytesPerLine before
    const int count = d.byte(kind);
    if (count == 0) {
      size.shortest = d.dword(first);
      size.longest = d.dword(first + 4);
      size.step = d.dword(first + 8);
    }
    for (int i = 0; i < count; ++i) {
      size.intervals.push_back(d.dword(first + 4 * static_cast<std::size_t>(i)));
    }
    stream().formats.back().sizes.push_back(std::move(size));
  }

  void take_endpoint(const Descriptor& d) {
    const int type = d.byte(3) & kTransferType;
    if (type != kIsochronous && type != kBulk) return;
    const int size = d.word(4);
    // Bits 11 and 12: further transactions a microframe (high speed).
    const int transactions = type == kIsochronous ? 1 + ((size >> 11) & 3) : 1;
    stream().alternates.push_back({setting_, static_cast<std::uint8_t>(d.byte(2)),
                                   type == kIsochronous, (size & 0x7ff) * transactions});
  }

  void take_companion(const Descriptor& d) {
    if (stream().alternates.empty()) return;
    UvcAlternate& alternate = stream().alternates.back();
    if (alternate.isochronous) alternate.bytes = d.word(4);  // wBytesPerInterval
  }

  std::vector<UvcFunction> functions_;
  int subclass_ = 0;
  int setting_ = 0;
};

}  // namespace

std::uint32_t UvcFrameSize::nearest_interval(double seconds) const {
  const double wanted = seconds / kUvcTick;
  if (intervals.empty()) {
    if (shortest == 0) return default_interval;
    const double clamped = std::clamp(wanted, static_cast<double>(shortest),
                                      static_cast<double>(std::max(shortest, longest)));
    const double steps = step > 0 ? std::round((clamped - shortest) / step) : 0;
    return shortest + static_cast<std::uint32_t>(steps) * step;
  }
  return *std::min_element(intervals.begin(), intervals.end(), [&](auto a, auto b) {
    return std::abs(a - wanted) < std::abs(b - wanted);
  });
}

bool UvcStream::is_isochronous() const {
  return std::any_of(alternates.begin(), alternates.end(),
                     [](const UvcAlternate& alternate) { return alternate.isochronous; });
}

const UvcAlternate& UvcStream::alternate_for(std::uint32_t bytes) const {
  const UvcAlternate* best = nullptr;
  for (const UvcAlternate& alternate : alternates) {
    if (alternate.bytes == 0) continue;
    const bool carries = static_cast<std::uint32_t>(alternate.bytes) >= bytes;
    const bool best_carries = best != nullptr && static_cast<std::uint32_t>(best->bytes) >= bytes;
    const bool is_better = best == nullptr || (carries && !best_carries) ||
                           (carries == best_carries && (carries ? alternate.bytes < best->bytes
                                                                : alternate.bytes > best->bytes));
    if (is_better) best = &alternate;
  }
  if (best == nullptr) throw std::runtime_error("the camera's stream has no endpoint");
  return *best;
}

bool UvcFunction::has(UvcTerminalControl control) const {
  return camera_terminal != 0 && (terminal_controls >> static_cast<int>(control) & 1) != 0;
}

bool UvcFunction::has(UvcProcessingControl control) const {
  return processing_unit != 0 && (processing_controls >> static_cast<int>(control) & 1) != 0;
}

std::vector<UvcFunction> parse_uvc_descriptors(std::span<const std::uint8_t> bytes) {
  Parser parser;
  for (std::size_t at = 0; at < bytes.size();) {
    const std::size_t length = bytes[at];
    if (length < 2 || at + length > bytes.size()) {
      throw std::runtime_error(
          fmt::format("USB descriptors are cut short at byte {}: {} bytes announced, {} there", at,
                      length, bytes.size() - at));
    }
    parser.take({bytes.subspan(at, length), at});
    at += length;
  }
  return parser.take_result();
}

}  // namespace gastronaut

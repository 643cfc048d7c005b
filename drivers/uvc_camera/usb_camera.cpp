#include "uvc_camera/usb_camera.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

namespace gastronaut {
namespace {

// Requests and control selectors (UVC 1.5, appendix A.8 and A.9).
constexpr std::uint8_t kSetCurrent = 0x01;
constexpr std::uint8_t kGetCurrent = 0x81;
constexpr std::uint8_t kGetLeast = 0x82;
constexpr std::uint8_t kGetMost = 0x83;
constexpr std::uint8_t kGetStep = 0x84;
constexpr std::uint8_t kGetDefault = 0x87;
constexpr int kProbe = 1;
constexpr int kCommit = 2;

// bits of the exposure mode
constexpr int kManual = 1;
constexpr int kAutomatic = 2;
constexpr int kAperturePriority = 8;

struct Selector {
  bool is_terminal;  // of the camera terminal, else of the processing unit
  int bit;           // in its bmControls
  int selector;
  std::size_t bytes;
};

Selector selector_of(CameraControl control) {
  const auto terminal = [](UvcTerminalControl bit, int selector, std::size_t bytes) {
    return Selector{true, static_cast<int>(bit), selector, bytes};
  };
  const auto processing = [](UvcProcessingControl bit, int selector, std::size_t bytes) {
    return Selector{false, static_cast<int>(bit), selector, bytes};
  };
  switch (control) {
    case CameraControl::kAutomaticExposure:
      return terminal(UvcTerminalControl::kExposureMode, 2, 1);
    case CameraControl::kExposurePriority:
      return terminal(UvcTerminalControl::kExposurePriority, 3, 1);
    case CameraControl::kExposureTime:
      return terminal(UvcTerminalControl::kExposureTime, 4, 4);
    case CameraControl::kGain:
      return processing(UvcProcessingControl::kGain, 4, 2);
    case CameraControl::kWhiteBalance:
      return processing(UvcProcessingControl::kWhiteBalanceTemperature, 0x0a, 2);
    case CameraControl::kAutomaticWhiteBalance:
      return processing(UvcProcessingControl::kWhiteBalanceTemperatureAuto, 0x0b, 1);
    case CameraControl::kBacklightCompensation:
      return processing(UvcProcessingControl::kBacklightCompensation, 1, 2);
  }
  return {};
}

// Where a control is reached; nothing: this camera has it not.
struct Address {
  std::uint16_t value;
  std::uint16_t index;
  std::size_t bytes;
};
std::optional<Address> address_of(const UvcFunction& function, CameraControl control) {
  const Selector selector = selector_of(control);
  const int unit = selector.is_terminal ? function.camera_terminal : function.processing_unit;
  const std::uint32_t there =
      selector.is_terminal ? function.terminal_controls : function.processing_controls;
  if (unit == 0 || (there >> selector.bit & 1) == 0) return std::nullopt;
  return Address{static_cast<std::uint16_t>(selector.selector << 8),
                 static_cast<std::uint16_t>(unit << 8 | function.interface), selector.bytes};
}

std::optional<int> ask(UsbTransport& transport, std::uint8_t request, const Address& address) {
  std::array<std::uint8_t, 4> data{};
  if (!transport.get(request, address.value, address.index, std::span(data).first(address.bytes))) {
    return std::nullopt;
  }
  std::uint32_t value = 0;
  for (std::size_t i = 0; i < address.bytes; ++i) value |= std::uint32_t{data[i]} << (8 * i);
  return static_cast<int>(value);
}

void put(std::span<std::uint8_t> at, std::uint32_t value) {
  for (std::uint8_t& byte : at) {
    byte = static_cast<std::uint8_t>(value);
    value >>= 8;
  }
}

std::uint32_t read(std::span<const std::uint8_t> at) {
  std::uint32_t value = 0;
  for (std::size_t i = at.size(); i-- > 0;) value = value << 8 | at[i];
  return value;
}

std::string offered(const UvcFunction& function) {
  std::string text;
  for (const UvcStream& stream : function.streams) {
    for (const UvcFormat& format : stream.formats) {
      if (format.encoding == UvcEncoding::kOther) continue;
      text += (text.empty() ? "" : "; ") + format.name;
      for (const UvcFrameSize& size : format.sizes) {
        text += fmt::format(" {}x{}", size.width, size.height);
      }
    }
  }
  return text.empty() ? "nothing that this driver reads (MJPEG, YUYV)" : text;
}

}  // namespace

std::optional<int> UsbCameraControls::get(CameraControl control) {
  const auto address = address_of(function_, control);
  if (!address) return std::nullopt;
  const auto value = ask(transport_, kGetCurrent, *address);
  if (value && control == CameraControl::kAutomaticExposure) return *value == kManual ? 0 : 1;
  return value;
}

std::optional<ControlRange> UsbCameraControls::range(CameraControl control) {
  const auto address = address_of(function_, control);
  if (!address) return std::nullopt;
  if (address->bytes == 1) return ControlRange{0, 1, 1, 0};  // a switch has no range to ask for
  const auto least = ask(transport_, kGetLeast, *address);
  const auto most = ask(transport_, kGetMost, *address);
  if (!least || !most || *most < *least) return std::nullopt;
  return ControlRange{*least, *most, std::max(1, ask(transport_, kGetStep, *address).value_or(1)),
                      ask(transport_, kGetDefault, *address).value_or(*least)};
}

bool UsbCameraControls::set(CameraControl control, int value) {
  const auto address = address_of(function_, control);
  if (!address) return false;
  const auto send = [&](int word) {
    std::array<std::uint8_t, 4> data{};
    put(data, static_cast<std::uint32_t>(word));
    return transport_.set(kSetCurrent, address->value, address->index,
                          std::span<const std::uint8_t>(data).first(address->bytes));
  };
  if (control != CameraControl::kAutomaticExposure) return send(value);
  if (value == 0) return send(kManual);
  return send(kAperturePriority) || send(kAutomatic);
}

UvcStreamSettings choose_stream(const UvcFunction& function, const RigConfiguration& rig) {
  const std::string& wanted = rig.uvc_camera.format;
  for (const UvcEncoding encoding : {UvcEncoding::kMjpeg, UvcEncoding::kYuyv}) {
    if (wanted == "mjpeg" && encoding != UvcEncoding::kMjpeg) continue;
    if (wanted == "yuyv" && encoding != UvcEncoding::kYuyv) continue;
    for (const UvcStream& stream : function.streams) {
      for (const UvcFormat& format : stream.formats) {
        if (format.encoding != encoding) continue;
        for (const UvcFrameSize& size : format.sizes) {
          if (size.width != rig.camera.width || size.height != rig.camera.height) continue;
          UvcStreamSettings settings;
          settings.stream = &stream;
          settings.format = &format;
          settings.size = &size;
          settings.interval = size.nearest_interval(1 / rig.camera.rate);
          return settings;
        }
      }
    }
  }
  throw ConfigurationError(
      fmt::format("the camera offers no {}x{}{}: it has {}; set camera.width, camera.height{}",
                  rig.camera.width, rig.camera.height, wanted == "auto" ? "" : " in " + wanted,
                  offered(function), wanted == "auto" ? "" : ", uvc_camera.format"));
}

UsbCamera::UsbCamera(std::unique_ptr<UsbTransport> transport, UvcFunction function,
                     const RigConfiguration& rig, std::string name, Clock clock)
    : transport_(std::move(transport)),
      function_(std::move(function)),
      name_(std::move(name)),
      clock_(std::move(clock)),
      settings_(choose_stream(function_, rig)) {
  encoding_ = settings_.format->encoding == UvcEncoding::kMjpeg ? PictureEncoding::kMjpeg
                                                                : PictureEncoding::kYuyv;
  UsbCameraControls controls(*transport_, function_);
  locked_ = lock_controls(controls, rig.uvc_camera);
  negotiate();
  start();
}

UsbCamera::~UsbCamera() {
  try {
    transport_->stop();
    // The setting without bandwidth is how an isochronous camera is told to stop.
    if (settings_.stream->is_isochronous()) {
      transport_->select_alternate(settings_.stream->interface, 0);
    }
  } catch (const CameraUnavailable&) {  // a camera that is gone does not send
  }
}

void UsbCamera::negotiate() {
  constexpr std::size_t kLongest = 48;
  const std::size_t length = function_.version >= 0x0150   ? kLongest
                             : function_.version >= 0x0110 ? 34
                                                           : 26;
  const auto interface = static_cast<std::uint16_t>(settings_.stream->interface);
  std::array<std::uint8_t, kLongest> bytes{};
  const auto block = std::span(bytes).first(length);
  const auto field = [&](std::size_t at, std::size_t size) { return block.subspan(at, size); };
  put(field(0, 2), 1);  // bmHint: the frame interval is to stay
  put(field(2, 1), static_cast<std::uint32_t>(settings_.format->index));
  put(field(3, 1), static_cast<std::uint32_t>(settings_.size->index));
  put(field(4, 4), settings_.interval);
  const auto request = [&](int control) {
    return transport_->set(kSetCurrent, static_cast<std::uint16_t>(control << 8), interface, block);
  };
  if (!request(kProbe) ||
      !transport_->get(kGetCurrent, static_cast<std::uint16_t>(kProbe << 8), interface, block) ||
      !request(kCommit)) {
    throw CameraUnavailable(fmt::format("{} refuses {} {}x{}", name_, settings_.format->name,
                                        settings_.size->width, settings_.size->height));
  }
  settings_.interval = read(field(4, 4));
  settings_.largest_frame = read(field(18, 4));
  settings_.largest_payload = read(field(22, 4));
  // Some cameras announce nothing, or less than an uncompressed picture has.
  const auto pixels = static_cast<std::uint32_t>(settings_.size->width * settings_.size->height);
  settings_.largest_frame = std::max(settings_.largest_frame, 2 * pixels);
}

void UsbCamera::start() {
  UvcFrameAssembler::Settings settings;
  settings.largest_frame = settings_.largest_frame;
  settings.largest_payload = settings_.largest_payload;
  settings.clock_frequency = function_.clock_frequency;
  assembler_ = std::make_unique<UvcFrameAssembler>(
      settings, [this](UvcFrame frame) { take(std::move(frame)); });
  const bool is_isochronous = settings_.stream->is_isochronous();
  const UvcAlternate& alternate = settings_.stream->alternate_for(settings_.largest_payload);
  if (is_isochronous) {
    transport_->select_alternate(settings_.stream->interface, alternate.setting);
    transport_->start_isochronous(alternate.endpoint, alternate.bytes,
                                  [this](const UsbTransport::Received& received) {
                                    if (received.is_lost) return assembler_->add_loss();
                                    assembler_->add_payload(received.data, clock_());
                                  });
  } else {
    constexpr std::uint32_t kMost = 1 << 18;  // bytes a transfer
    const std::uint32_t packets = (std::clamp<std::uint32_t>(settings_.largest_payload, 1, kMost) +
                                   static_cast<std::uint32_t>(alternate.bytes) - 1) /
                                  static_cast<std::uint32_t>(alternate.bytes);
    transport_->start_bulk(alternate.endpoint, static_cast<int>(packets) * alternate.bytes,
                           [this](const UsbTransport::Received& received) {
                             if (received.is_lost) return assembler_->add_loss();
                             assembler_->add_bulk_transfer(received.data, received.is_short,
                                                           clock_());
                           });
  }
}

void UsbCamera::take(UvcFrame frame) {
  if (!picture_problem(encoding_, settings_.size->width, settings_.size->height, frame.data)
           .empty()) {
    ++undecodable_;
    return;
  }
  ++whole_;
  Picture picture;
  picture.encoding = encoding_;
  picture.width = settings_.size->width;
  picture.height = settings_.size->height;
  picture.utime = frame.arrival;
  if (frame.capture) {
    constexpr double kMicroseconds = 1e6;
    picture.utime = *frame.capture + std::llround(locked_.exposure.value_or(0) / 2 * kMicroseconds);
  }
  picture.data = std::move(frame.data);
  pictures_.push_back(std::move(picture));
}

std::optional<Picture> UsbCamera::next(double seconds) {
  if (pictures_.empty()) transport_->serve(seconds);
  if (pictures_.empty()) return std::nullopt;
  Picture picture = std::move(pictures_.front());
  pictures_.pop_front();
  return picture;
}

CameraCounters UsbCamera::counters() const {
  const UvcFrameAssembler::Counters& assembled = assembler_->counters();
  return {whole_, assembled.damaged + assembled.oversized + undecodable_, 0};
}

std::string UsbCamera::describe() const {
  return fmt::format("{} by libusb, {} {}x{} at {:.4g} Hz", name_, settings_.format->name,
                     settings_.size->width, settings_.size->height,
                     1 / (settings_.interval * kUvcTick));
}

}  // namespace gastronaut

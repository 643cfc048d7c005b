#include "unit/drivers/uvc_camera/played_camera.hpp"

#include <algorithm>
#include <string>

namespace gastronaut {
namespace {

constexpr int kTerminal = 1;
constexpr int kProcessing = 2;
constexpr std::uint32_t kIntervals[] = {333333, 500000, 1000000, 2000000};  // 30, 20, 10, 5 Hz
constexpr int kPacketSizes[] = {0, 192, 1024, 3072};                        // by alternate setting
constexpr int kIsochronousPayload = 1024;

void add(Octets& to, std::uint32_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) to.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
}

// A descriptor without its length, which it gets.
void add_descriptor(Octets& to, const Octets& body) {
  to.push_back(static_cast<std::uint8_t>(body.size() + 1));
  to.insert(to.end(), body.begin(), body.end());
}

std::uint32_t read(std::span<const std::uint8_t> from, std::size_t at, int bytes) {
  std::uint32_t value = 0;
  for (int i = 0; i < bytes; ++i) {
    value |= std::uint32_t{from[at + static_cast<std::size_t>(i)]} << (8 * i);
  }
  return value;
}

Octets stream_formats() {
  Octets formats;
  for (const int format : {1, 2}) {
    Octets body;
    if (format == 1) {
      body = {0x24, 6, 1, 3, 1, 1, 0, 0, 0, 0};
    } else {
      body = {0x24, 4,    2,    3,    'Y',  'U',  'Y',  '2', 0, 0, 0x10, 0, 0x80,
              0x00, 0x00, 0xaa, 0x00, 0x38, 0x9b, 0x71, 16,  1, 0, 0,    0, 0};
    }
    add_descriptor(formats, body);
    int frame = 0;
    for (const auto& [width, height] : PlayedCamera::kSizes) {
      const auto bytes = static_cast<std::uint32_t>(2 * width * height);
      body = {0x24, static_cast<std::uint8_t>(format == 1 ? 7 : 5),
              static_cast<std::uint8_t>(++frame), 0};
      add(body, static_cast<std::uint32_t>(width), 2);
      add(body, static_cast<std::uint32_t>(height), 2);
      add(body, bytes * 8 * 5, 4);
      add(body, bytes * 8 * 30, 4);
      add(body, bytes, 4);
      add(body, kIntervals[0], 4);
      body.push_back(std::size(kIntervals));
      for (const std::uint32_t interval : kIntervals) add(body, interval, 4);
      add_descriptor(formats, body);
    }
  }
  return formats;
}

}  // namespace

PlayedCamera::PlayedCamera(bool is_isochronous) : is_isochronous_(is_isochronous) {
  probe_.interval = kIntervals[0];
  controls_[{kTerminal, 2}] = {1, 8, 0, 0, 8};                   // exposure mode: aperture priority
  controls_[{kTerminal, 3}] = {1, 1, 0, 1, 1};                   // exposure priority
  controls_[{kTerminal, 4}] = {4, 166, 1, 5000, 166};            // exposure time
  controls_[{kProcessing, 4}] = {2, 16, 0, 255, 16};             // gain
  controls_[{kProcessing, 0x0a}] = {2, 4000, 2800, 6500, 4000};  // white balance
  controls_[{kProcessing, 0x0b}] = {1, 1, 0, 1, 1};              // its automatic
}

Octets PlayedCamera::device_descriptor() const {
  Octets bytes = {18, 1, 0, 2, 0xef, 2, 1, 64};
  add(bytes, kVendor, 2);
  add(bytes, kProduct, 2);
  add(bytes, 0x0100, 2);
  for (const int index : {1, 2, 3, 1}) bytes.push_back(static_cast<std::uint8_t>(index));
  return bytes;
}

Octets PlayedCamera::configuration_descriptor() const {
  Octets rest;
  add_descriptor(rest, {11, 0, 2, 0x0e, 3, 0, 0});    // the two interfaces are one camera
  add_descriptor(rest, {4, 0, 0, 0, 0x0e, 1, 0, 0});  // video control
  Octets units;
  // Camera terminal: exposure mode, priority, time. Processing unit: white balance, gain,
  // automatic.
  add_descriptor(units, {0x24, 2, kTerminal, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0, 3, 0x0e, 0, 0});
  add_descriptor(units, {0x24, 5, kProcessing, kTerminal, 0, 0, 2, 0x40, 0x12, 0, 0});
  add_descriptor(units, {0x24, 3, 3, 0x01, 0x01, 0, kProcessing, 0});
  Octets header = {0x24, 1, 0x10, 0x01};
  add(header, static_cast<std::uint32_t>(13 + units.size()), 2);
  add(header, kClockFrequency, 4);
  header.push_back(1);
  header.push_back(1);
  add_descriptor(rest, header);
  rest.insert(rest.end(), units.begin(), units.end());
  const Octets formats = stream_formats();
  const auto interface = [&rest](int setting, int endpoints) {
    add_descriptor(rest, {4, 1, static_cast<std::uint8_t>(setting),
                          static_cast<std::uint8_t>(endpoints), 0x0e, 2, 0, 0});
  };
  const auto endpoint = [&rest](int attributes, int packet) {
    add_descriptor(rest,
                   {5, kEndpoint, static_cast<std::uint8_t>(attributes),
                    static_cast<std::uint8_t>(packet), static_cast<std::uint8_t>(packet >> 8), 1});
  };
  interface(0, is_isochronous_ ? 0 : 1);
  Octets input = {0x24, 1, 2};
  add(input, static_cast<std::uint32_t>(15 + formats.size()), 2);
  for (const int byte : {int{kEndpoint}, 0, 3, 0, 0, 0, 1, 0, 0}) {
    input.push_back(static_cast<std::uint8_t>(byte));
  }
  add_descriptor(rest, input);
  rest.insert(rest.end(), formats.begin(), formats.end());
  if (is_isochronous_) {
    for (int setting = 1; setting < 4; ++setting) {
      interface(setting, 1);
      const int bytes = kPacketSizes[setting];
      endpoint(5, bytes > 1024 ? 1024 | (bytes / 1024 - 1) << 11 : bytes);
    }
  } else {
    endpoint(2, 512);
  }
  Octets bytes = {9, 2};
  add(bytes, static_cast<std::uint32_t>(9 + rest.size()), 2);
  for (const int byte : {2, 1, 0, 0x80, 250}) bytes.push_back(static_cast<std::uint8_t>(byte));
  bytes.insert(bytes.end(), rest.begin(), rest.end());
  return bytes;
}

std::optional<Octets> PlayedCamera::answer(const Setup& setup, std::span<const std::uint8_t> data) {
  constexpr int kClassToInterface = 0x21;
  if ((setup.type & 0x60) == 0) {
    if (setup.request == 11) {  // SET_INTERFACE
      if (setup.index != 1) return Octets{};
      alternate_ = setup.value;
      if (is_isochronous_) is_streaming_ = alternate_ > 0;
      return alternate_ < (is_isochronous_ ? 4 : 1) ? std::optional(Octets{}) : std::nullopt;
    }
    // CLEAR_FEATURE(ENDPOINT_HALT): how a bulk camera is told to stop.
    if (setup.request == 1 && setup.index == kEndpoint) is_streaming_ = false;
    return answer_standard(setup);
  }
  if ((setup.type & 0x7f) != kClassToInterface) return std::nullopt;
  return (setup.index & 0xff) == 1 ? answer_stream(setup, data) : answer_control(setup, data);
}

std::optional<Octets> PlayedCamera::answer_standard(const Setup& setup) const {
  Octets bytes;
  switch (setup.request) {
    case 0:  // GET_STATUS
      bytes = {0, 0};
      break;
    case 1:  // CLEAR_FEATURE
    case 3:  // SET_FEATURE
    case 9:  // SET_CONFIGURATION
      return bytes;
    case 8:  // GET_CONFIGURATION
      bytes = {1};
      break;
    case 10:  // GET_INTERFACE
      bytes = {static_cast<std::uint8_t>(setup.index == 1 ? alternate_ : 0)};
      break;
    case 6: {  // GET_DESCRIPTOR
      const int index = setup.value & 0xff;
      switch (setup.value >> 8) {
        case 1:
          bytes = device_descriptor();
          break;
        case 2:
          bytes = configuration_descriptor();
          break;
        case 3: {
          const std::string texts[] = {"", "gastronaut tests", "played camera", kSerial};
          if (index > 3) return std::nullopt;
          Octets body = {3};
          if (index == 0) add(body, 0x0409, 2);
          for (const char character : texts[index]) {
            add(body, static_cast<std::uint8_t>(character), 2);
          }
          add_descriptor(bytes, body);
          break;
        }
        default:
          return std::nullopt;  // a high-speed device that has no other speed stalls
      }
      break;
    }
    default:
      return std::nullopt;
  }
  bytes.resize(std::min<std::size_t>(bytes.size(), setup.length));
  return bytes;
}

std::optional<Octets> PlayedCamera::answer_control(const Setup& setup,
                                                   std::span<const std::uint8_t> data) {
  const auto found = controls_.find({setup.index >> 8, setup.value >> 8});
  if (found == controls_.end()) return std::nullopt;
  Control& control = found->second;
  if (setup.request == 0x01) {
    const auto value = static_cast<int>(read(data, 0, static_cast<int>(data.size())));
    const bool is_mode = setup.index >> 8 == kTerminal && setup.value >> 8 == 2;
    if (is_mode ? (value != 1 && value != 8) : (value < control.least || value > control.most)) {
      return std::nullopt;
    }
    control.value = value;
    return Octets{};
  }
  const std::map<int, int> answers = {{0x81, control.value},
                                      {0x82, control.least},
                                      {0x83, control.most},
                                      {0x84, 1},
                                      {0x87, control.preset}};
  Octets bytes;
  if (setup.request == 0x86) return Octets{3};  // GET_INFO: may be read and written
  if (setup.request == 0x85) {                  // GET_LEN
    add(bytes, static_cast<std::uint32_t>(control.bytes), 2);
    return bytes;
  }
  const auto answer = answers.find(setup.request);
  if (answer == answers.end()) return std::nullopt;
  add(bytes, static_cast<std::uint32_t>(answer->second), static_cast<int>(control.bytes));
  return bytes;
}

std::optional<Octets> PlayedCamera::answer_stream(const Setup& setup,
                                                  std::span<const std::uint8_t> data) {
  const int selector = setup.value >> 8;
  if (selector != 1 && selector != 2) return std::nullopt;
  if (setup.request == 0x01) {
    if (data.size() < 26) return std::nullopt;
    probe_.format = static_cast<std::uint8_t>(std::clamp<int>(data[2], 1, 2));
    probe_.frame = static_cast<std::uint8_t>(std::clamp<int>(data[3], 1, 3));
    const std::uint32_t wanted = read(data, 4, 4);
    probe_.interval =
        *std::min_element(std::begin(kIntervals), std::end(kIntervals), [wanted](auto a, auto b) {
          const auto off = [wanted](std::uint32_t x) {
            return x > wanted ? x - wanted : wanted - x;
          };
          return off(a) < off(b);
        });
    if (selector == 2 && !is_isochronous_) is_streaming_ = true;
    return Octets{};
  }
  if (setup.request == 0x86) return Octets{3};
  Octets bytes;
  if (setup.request == 0x85) {
    add(bytes, 34, 2);
    return bytes;
  }
  if (setup.request != 0x81 && setup.request != 0x82 && setup.request != 0x83 &&
      setup.request != 0x87) {
    return std::nullopt;
  }
  add(bytes, 1, 2);
  bytes.push_back(probe_.format);
  bytes.push_back(probe_.frame);
  add(bytes, probe_.interval, 4);
  bytes.resize(18, 0);
  add(bytes, static_cast<std::uint32_t>(2 * width() * height()), 4);
  add(bytes, static_cast<std::uint32_t>(payload_bytes()), 4);
  add(bytes, kClockFrequency, 4);
  bytes.resize(34, 0);
  bytes.resize(std::min<std::size_t>(bytes.size(), setup.length));
  return bytes;
}

double PlayedCamera::interval() const { return probe_.interval * 1e-7; }

int PlayedCamera::payload_bytes() const {
  return is_isochronous_ ? kIsochronousPayload : static_cast<int>(kBulkPayload);
}

std::vector<Octets> PlayedCamera::payloads(std::span<const std::uint8_t> picture,
                                           std::uint32_t begin, std::uint32_t sent,
                                           const Faults& faults) {
  constexpr std::size_t kHeader = 12;
  const std::size_t most = static_cast<std::size_t>(payload_bytes()) - kHeader;
  const auto kept =
      static_cast<std::size_t>(faults.kept_share * static_cast<double>(picture.size()));
  std::vector<Octets> result;
  for (std::size_t at = 0; at < kept; at += most) {
    const auto part = picture.subspan(at, std::min(most, kept - at));
    const bool is_last = at + most >= kept;
    const bool has_error = faults.has_error && at == 0;
    Octets& payload = result.emplace_back();
    payload.push_back(kHeader);
    payload.push_back(static_cast<std::uint8_t>(0x8c | (identifier_ ? 1 : 0) |
                                                (is_last && !faults.is_end_missing ? 2 : 0) |
                                                (has_error ? 0x40 : 0)));
    add(payload, begin, 4);
    add(payload, sent, 4);
    add(payload, 0, 2);
    payload.insert(payload.end(), part.begin(), part.end());
  }
  identifier_ = !identifier_;
  return result;
}

}  // namespace gastronaut

// Plugs a played camera into this machine's virtual USB host controller (vhci_hcd): the kernel and
// libusb meet it as they meet any camera. Its pictures are those on CAMERA of an LCM log, sent at
// the rate that the host asks for, as often as it takes. Stops on SIGTERM. usage: usbip_camera LOG
// SENT [--bulk] [--cut N] [--error N] [--silent-after N]
//                     [--unplug-after N]
// SENT gets a line for each picture that was sent whole: utime of its first payload, number in LOG.
// N counts pictures: each Nth is cut short (or marked), or after N the camera falls silent (or is
// unplugged and plugged in again two seconds later), once.
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <chrono>
#include <csignal>
#include <cstring>
#include <deque>
#include <fstream>
#include <gastronaut/image_t.hpp>
#include <iostream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "bus/log_file.hpp"
#include "bus/wall_clock.hpp"
#include "bus/wire.hpp"
#include "process/channels.hpp"
#include "unit/drivers/uvc_camera/played_camera.hpp"
#include "unit/drivers/uvc_camera/test_pictures.hpp"

namespace gastronaut {
namespace {

volatile std::sig_atomic_t g_stop = 0;

struct Options {
  std::string log;
  std::string sent;
  bool is_bulk = false;
  int cut = 0;
  int error = 0;
  int silent_after = 0;
  int unplug_after = 0;
};

// A message of the USB/IP protocol (Linux, Documentation/usb/usbip_protocol.rst): 48 bytes,
// big-endian.
struct Header {
  std::array<std::uint32_t, 12> words{};
  std::uint32_t command() const { return words[0]; }
  std::uint32_t number() const { return words[1]; }
  bool is_in() const { return words[3] == 1; }
  std::uint32_t endpoint() const { return words[4]; }
};
constexpr std::uint32_t kSubmit = 1;
constexpr std::uint32_t kUnlink = 2;
constexpr std::uint32_t kSubmitted = 3;
constexpr std::uint32_t kUnlinked = 4;

std::uint32_t swapped(std::uint32_t word) { return __builtin_bswap32(word); }

// A request for data that waits until there is some.
struct Pending {
  Header header;
  std::uint32_t length = 0;
  struct Packet {
    std::uint32_t offset = 0;
    std::uint32_t length = 0;
  };
  std::vector<Packet> packets;  // isochronous
};

class Device {
 public:
  Device(int socket, const Options& options, const std::vector<Octets>& pictures, int& number,
         std::ofstream& sent)
      : socket_(socket),
        options_(options),
        pictures_(pictures),
        number_(number),
        sent_(sent),
        camera_(!options.is_bulk) {}
  ~Device() { close(socket_); }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  // Serves the host until it hangs up, or the device is to be unplugged (true).
  bool run() {
    while (g_stop == 0) {
      pollfd polled{socket_, POLLIN, 0};
      constexpr int kTick = 2;  // milliseconds
      if (poll(&polled, 1, kTick) > 0 && !take_message()) return false;
      if (send_pictures()) return true;
    }
    return false;
  }

 private:
  using Clock = std::chrono::steady_clock;

  bool read_all(void* to, std::size_t bytes) {
    return recv(socket_, to, bytes, MSG_WAITALL) == static_cast<ssize_t>(bytes);
  }
  void write_all(const Octets& bytes) {
    for (std::size_t at = 0; at < bytes.size();) {
      const ssize_t written = send(socket_, bytes.data() + at, bytes.size() - at, MSG_NOSIGNAL);
      if (written <= 0) return;
      at += static_cast<std::size_t>(written);
    }
  }

  bool take_message() {
    Header header;
    if (!read_all(header.words.data(), sizeof(header.words))) return false;
    // The last two words are a setup packet, which has an order of its own.
    for (std::size_t i = 0; i < 10; ++i) header.words[i] = swapped(header.words[i]);
    if (header.command() == kUnlink) {
      unlink(header);
      return true;
    }
    if (header.command() != kSubmit) throw std::runtime_error("not a USB/IP message");
    const std::uint32_t length = header.words[6];
    Octets out(header.is_in() ? 0 : length);
    if (!out.empty() && !read_all(out.data(), out.size())) return false;
    Pending pending{header, length, {}};
    const std::uint32_t packets = header.words[8];
    if (packets != 0 && packets != 0xffffffff) {
      std::vector<std::array<std::uint32_t, 4>> descriptors(packets);
      if (!read_all(descriptors.data(), packets * sizeof(descriptors[0]))) return false;
      for (const auto& d : descriptors) pending.packets.push_back({swapped(d[0]), swapped(d[1])});
    }
    if (header.endpoint() == 0) {
      control(pending, out);
    } else {
      pending_.push_back(std::move(pending));
    }
    return true;
  }

  void control(const Pending& pending, const Octets& out) {
    std::array<std::uint8_t, 8> b{};
    std::memcpy(b.data(), &pending.header.words[10], b.size());
    const auto word = [&b](std::size_t at) {
      return static_cast<std::uint16_t>(b[at] | b[at + 1] << 8);
    };
    const bool was_streaming = camera_.is_streaming();
    const auto answer = camera_.answer({b[0], b[1], word(2), word(4), word(6)}, out);
    if (camera_.is_streaming() && !was_streaming) {
      payloads_.clear();
      next_ = Clock::now();
      is_silent_ = false;
    }
    const int status = answer ? 0 : -EPIPE;
    complete(pending, status, answer.value_or(Octets{}), out.size(), {});
  }

  // `data` goes along for IN; `out` bytes were taken for OUT.
  void complete(const Pending& pending, int status, const Octets& data, std::size_t out,
                const std::vector<std::uint32_t>& packet_bytes) {
    std::array<std::uint32_t, 12> words{};
    words[0] = kSubmitted;
    words[1] = pending.header.number();
    words[5] = static_cast<std::uint32_t>(status);
    words[6] = static_cast<std::uint32_t>(data.empty() ? out : data.size());
    words[8] = pending.header.words[8];
    for (auto& value : words) value = swapped(value);
    Octets bytes(sizeof(words));
    std::memcpy(bytes.data(), words.data(), sizeof(words));
    bytes.insert(bytes.end(), data.begin(), data.end());
    for (std::size_t i = 0; i < packet_bytes.size(); ++i) {
      for (const std::uint32_t value :
           {pending.packets[i].offset, pending.packets[i].length, packet_bytes[i], 0u}) {
        for (int shift = 24; shift >= 0; shift -= 8) {
          bytes.push_back(static_cast<std::uint8_t>(value >> shift));
        }
      }
    }
    write_all(bytes);
  }

  void unlink(const Header& header) {
    const std::uint32_t wanted = header.words[5];
    int status = 0;  // it has been answered already
    for (auto it = pending_.begin(); it != pending_.end(); ++it) {
      if (it->header.number() != wanted) continue;
      pending_.erase(it);
      status = -ECONNRESET;
      break;
    }
    std::array<std::uint32_t, 12> words{};
    words[0] = swapped(kUnlinked);
    words[1] = swapped(header.number());
    words[5] = swapped(static_cast<std::uint32_t>(status));
    Octets bytes(sizeof(words));
    std::memcpy(bytes.data(), words.data(), sizeof(words));
    write_all(bytes);
  }

  // True: the plug is to be pulled, in the middle of a picture.
  bool send_pictures() {
    if (!camera_.is_streaming() || is_silent_) return false;
    const auto now = Clock::now();
    if (payloads_.empty() && now >= next_) {
      if (!begin_picture()) return false;
      next_ += std::chrono::duration_cast<Clock::duration>(
          std::chrono::duration<double>(camera_.interval()));
      next_ = std::max(next_, now);  // what was missed is not made up for
    }
    while (!payloads_.empty() && !pending_.empty()) {
      answer_one();
    }
    return is_last_ && payloads_.empty();
  }

  bool begin_picture() {
    ++number_;
    if (options_.silent_after > 0 && number_ == options_.silent_after) {
      is_silent_ = true;
      return false;
    }
    const auto index = static_cast<std::size_t>(number_ - 1) % pictures_.size();
    PlayedCamera::Faults faults;
    constexpr double kCut = 0.7;
    if (options_.cut > 0 && number_ % options_.cut == 0) faults.kept_share = kCut;
    if (options_.error > 0 && number_ % options_.error == 0) faults.has_error = true;
    const std::int64_t utime = wall_utime();
    const auto clock = static_cast<std::uint32_t>(utime);  // PlayedCamera::kClockFrequency
    const Octets picture = camera_.is_mjpeg() ? pictures_[index]
                                              : yuyv_picture(camera_.width(), camera_.height(),
                                                             static_cast<int>(index));
    const auto payloads = camera_.payloads(picture, clock, clock, faults);
    payloads_.assign(payloads.begin(), payloads.end());
    if (number_ == options_.unplug_after) {
      payloads_.resize(payloads_.size() / 2);
      is_last_ = true;
      return true;
    }
    if (faults.kept_share == 1 && !faults.has_error) sent_ << utime << ' ' << index << std::endl;
    return true;
  }

  // Isochronous: a payload a packet. Bulk: a payload a transfer, or as much of it as was asked for.
  void answer_one() {
    const Pending pending = std::move(pending_.front());
    pending_.pop_front();
    Octets data;
    std::vector<std::uint32_t> packet_bytes;
    if (pending.packets.empty()) {
      Octets& payload = payloads_.front();
      const std::size_t size = std::min<std::size_t>(payload.size(), pending.length);
      data.assign(payload.begin(), payload.begin() + static_cast<std::ptrdiff_t>(size));
      payload.erase(payload.begin(), payload.begin() + static_cast<std::ptrdiff_t>(size));
      if (payload.empty()) payloads_.pop_front();
    }
    for (const Pending::Packet& packet : pending.packets) {
      const bool has_data = !payloads_.empty() && payloads_.front().size() <= packet.length;
      packet_bytes.push_back(has_data ? static_cast<std::uint32_t>(payloads_.front().size()) : 0u);
      if (!has_data) continue;
      data.insert(data.end(), payloads_.front().begin(), payloads_.front().end());
      payloads_.pop_front();
    }
    complete(pending, 0, data, 0, packet_bytes);
  }

  int socket_;
  const Options& options_;
  const std::vector<Octets>& pictures_;
  int& number_;  // of pictures begun, over all times it was plugged in
  std::ofstream& sent_;
  PlayedCamera camera_;
  std::deque<Pending> pending_;
  std::deque<Octets> payloads_;
  Clock::time_point next_;
  bool is_silent_ = false;
  bool is_last_ = false;  // the picture under way, of which half is sent
};

// Hands one end of a pair of sockets to the kernel, as a high-speed device; the other end.
int plug_in() {
  std::array<int, 2> ends{};
  if (socketpair(AF_UNIX, SOCK_STREAM, 0, ends.data()) != 0) {
    throw std::runtime_error("no socket pair");
  }
  constexpr int kHighSpeed = 3;
  constexpr int kDevice = 0x10002;
  std::ofstream attach("/sys/devices/platform/vhci_hcd.0/attach");
  attach << "0 " << ends[0] << ' ' << kDevice << ' ' << kHighSpeed << std::flush;
  if (!attach) throw std::runtime_error("vhci_hcd does not take the device: modprobe vhci_hcd");
  close(ends[0]);
  return ends[1];
}

std::vector<Octets> read_pictures(const std::string& log) {
  std::vector<Octets> pictures;
  LogReader reader(log);
  while (const auto event = reader.next()) {
    image_t image;
    if (event->channel == channel::kCamera &&
        decode_message(event->payload, image) == DecodeResult::kOk) {
      pictures.push_back(image.data);
    }
  }
  if (pictures.empty()) throw std::runtime_error(log + ": no pictures on CAMERA");
  return pictures;
}

Options parse(int argc, char** argv) {
  if (argc < 3) throw std::runtime_error("usage: usbip_camera LOG SENT [OPTION...]");
  Options options;
  options.log = argv[1];
  options.sent = argv[2];
  for (int i = 3; i < argc; ++i) {
    const std::string name = argv[i];
    if (name == "--bulk") {
      options.is_bulk = true;
      continue;
    }
    if (i + 1 == argc) throw std::runtime_error(name + " needs a number");
    const int value = std::stoi(argv[++i]);
    if (name == "--cut") {
      options.cut = value;
    } else if (name == "--error") {
      options.error = value;
    } else if (name == "--silent-after") {
      options.silent_after = value;
    } else if (name == "--unplug-after") {
      options.unplug_after = value;
    } else {
      throw std::runtime_error("unknown option " + name);
    }
  }
  return options;
}

int run(int argc, char** argv) {
  const Options options = parse(argc, argv);
  const std::vector<Octets> pictures = read_pictures(options.log);
  std::ofstream sent(options.sent);
  std::signal(SIGTERM, [](int) { g_stop = 1; });
  int number = 0;
  while (g_stop == 0) {
    {
      Device device(plug_in(), options, pictures, number, sent);
      std::cout << "plugged in" << std::endl;
      if (!device.run()) break;
    }
    std::cout << "pulled" << std::endl;
    constexpr auto kPause = std::chrono::seconds(2);
    std::this_thread::sleep_for(kPause);
  }
  return 0;
}

}  // namespace
}  // namespace gastronaut

int main(int argc, char** argv) {
  try {
    return gastronaut::run(argc, argv);
  } catch (const std::exception& problem) {
    std::cerr << "usbip_camera: " << problem.what() << "\n";
    return 1;
  }
}

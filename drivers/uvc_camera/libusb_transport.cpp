#include "uvc_camera/libusb_transport.hpp"

#include <fmt/format.h>
#include <libusb.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <fstream>
#include <iterator>
#include <utility>
#include <vector>

#include "uvc_camera/camera.hpp"
#include "uvc_camera/usb_camera.hpp"

namespace gastronaut {
namespace {

constexpr unsigned kControlTimeout = 1000;  // milliseconds
constexpr auto kStopTimeout = std::chrono::seconds(1);
// 16 transfers of 32 packets: 64 ms of high speed's microframes in which nobody needs to look.
constexpr int kIsochronousTransfers = 16;
constexpr int kPacketsPerTransfer = 32;
constexpr int kBulkTransfers = 8;
constexpr std::uint8_t kToInterface =
    std::uint8_t{LIBUSB_REQUEST_TYPE_CLASS} | std::uint8_t{LIBUSB_RECIPIENT_INTERFACE};
constexpr std::uint8_t kFromInterface = kToInterface | std::uint8_t{LIBUSB_ENDPOINT_IN};

class Context {
 public:
  Context() {
    if (const int result = libusb_init(&context_); result != 0) {
      throw CameraUnavailable(std::string("libusb: ") + libusb_strerror(result));
    }
  }
  ~Context() { libusb_exit(context_); }
  Context(const Context&) = delete;
  Context& operator=(const Context&) = delete;
  libusb_context* get() const { return context_; }

 private:
  libusb_context* context_ = nullptr;
};

// An opened device. Interfaces are given back to the kernel's driver when it is closed.
class Device {
 public:
  Device(std::shared_ptr<Context> context, libusb_device* device)
      : context_(std::move(context)), device_(device) {
    const int result = libusb_open(device, &handle_);
    if (result == LIBUSB_ERROR_ACCESS) {
      throw CameraUnavailable(fmt::format(
          "{} may not be used by this user; try: sudo usermod -aG video $USER, and install "
          "config/udev/60-gastronaut.rules",
          identity()));
    }
    if (result != 0) throw CameraUnavailable(identity() + ": " + libusb_strerror(result));
    libusb_set_auto_detach_kernel_driver(handle_, 1);
  }
  ~Device() {
    for (const int interface : claimed_) libusb_release_interface(handle_, interface);
    libusb_close(handle_);
  }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  libusb_device_handle* get() const { return handle_; }
  libusb_context* context() const { return context_->get(); }

  void claim(int interface) {
    const int result = libusb_claim_interface(handle_, interface);
    if (result == LIBUSB_ERROR_BUSY) {
      throw CameraUnavailable(identity() + " is in use by another program");
    }
    if (result != 0) throw CameraUnavailable(identity() + ": " + libusb_strerror(result));
    claimed_.push_back(interface);
  }

  std::string identity() const {
    const libusb_device_descriptor is = descriptor();
    return fmt::format("{:04x}:{:04x}", is.idVendor, is.idProduct);
  }
  libusb_device_descriptor descriptor() const {
    libusb_device_descriptor is{};
    libusb_get_device_descriptor(device_, &is);
    return is;
  }
  std::string text(std::uint8_t index) const {
    std::array<unsigned char, 256> bytes{};
    if (index == 0) return "";
    const int length = libusb_get_string_descriptor_ascii(handle_, index, bytes.data(),
                                                          static_cast<int>(bytes.size()));
    return length > 0 ? std::string(bytes.begin(), bytes.begin() + length) : "";
  }
  std::string serial() const { return text(descriptor().iSerialNumber); }
  std::string name() const {
    const std::string product = text(descriptor().iProduct);
    const std::string number = serial();
    return fmt::format("{} ({}{})", product.empty() ? "camera" : product, identity(),
                       number.empty() ? "" : ", serial " + number);
  }
  std::vector<UvcFunction> functions() const {
    // libusb reads no more than 4096 bytes of it; some cameras have more. The kernel has them all:
    // the device's descriptor, then that of each configuration.
    constexpr std::size_t kDevice = 18;
    constexpr std::size_t kTotalLength = 2;
    const std::string path = system_folder() + "/descriptors";
    std::ifstream file(path, std::ios::binary);
    std::vector<std::uint8_t> bytes{std::istreambuf_iterator<char>(file), {}};
    if (bytes.size() < kDevice + kTotalLength + 2) throw CameraUnavailable(path + " is not there");
    bytes.erase(bytes.begin(), bytes.begin() + kDevice);
    const std::size_t length = bytes[kTotalLength] | bytes[kTotalLength + 1] << 8;
    bytes.resize(std::min(bytes.size(), length));
    return parse_uvc_descriptors(bytes);
  }

 private:
  // Bus and ports: /sys/bus/usb/devices/1-2.3
  std::string system_folder() const {
    std::array<std::uint8_t, 8> ports{};
    const int depth =
        libusb_get_port_numbers(device_, ports.data(), static_cast<int>(ports.size()));
    std::string name = std::to_string(libusb_get_bus_number(device_));
    for (int i = 0; i < depth; ++i) {
      name += (i == 0 ? "-" : ".") + std::to_string(ports[static_cast<std::size_t>(i)]);
    }
    return "/sys/bus/usb/devices/" + name;
  }

  std::shared_ptr<Context> context_;
  libusb_device* device_;  // kept by the handle
  libusb_device_handle* handle_ = nullptr;
  std::vector<int> claimed_;
};

class LibusbTransport : public UsbTransport {
 public:
  LibusbTransport(std::shared_ptr<Device> device, std::string name)
      : state_(std::make_shared<State>()), name_(std::move(name)) {
    state_->device = std::move(device);
  }
  ~LibusbTransport() override { stop(); }
  LibusbTransport(const LibusbTransport&) = delete;
  LibusbTransport& operator=(const LibusbTransport&) = delete;

  bool get(std::uint8_t request, std::uint16_t value, std::uint16_t index,
           std::span<std::uint8_t> data) override {
    return control(kFromInterface, request, value, index, data.data(), data.size()) > 0;
  }

  bool set(std::uint8_t request, std::uint16_t value, std::uint16_t index,
           std::span<const std::uint8_t> data) override {
    std::vector<std::uint8_t> copy(data.begin(), data.end());
    return control(kToInterface, request, value, index, copy.data(), copy.size()) >= 0;
  }

  void select_alternate(int interface, int setting) override {
    // Asked of a device that is gone, libusb 1.0.26 unlocks what it has not locked, and aborts in
    // libusb_close() (its issue 1199): so first something harmless.
    std::uint8_t is = 0;
    constexpr std::uint8_t kFromStandard =
        std::uint8_t{LIBUSB_RECIPIENT_INTERFACE} | std::uint8_t{LIBUSB_ENDPOINT_IN};
    control(kFromStandard, LIBUSB_REQUEST_GET_INTERFACE, 0, static_cast<std::uint16_t>(interface),
            &is, 1);
    if (state_->is_gone) throw CameraUnavailable(name_ + " was unplugged");
    check(libusb_set_interface_alt_setting(handle(), interface, setting));
  }

  void start_isochronous(std::uint8_t endpoint, int bytes, Sink sink) override {
    state_->sink = std::move(sink);
    for (int i = 0; i < kIsochronousTransfers; ++i) {
      libusb_transfer* transfer = add_transfer(kPacketsPerTransfer, kPacketsPerTransfer * bytes);
      libusb_fill_iso_transfer(transfer, handle(), endpoint, transfer->buffer, transfer->length,
                               kPacketsPerTransfer, &on_isochronous, state_.get(), 0);
      libusb_set_iso_packet_lengths(transfer, static_cast<unsigned>(bytes));
    }
    submit_all();
  }

  void start_bulk(std::uint8_t endpoint, int bytes, Sink sink) override {
    state_->sink = std::move(sink);
    state_->endpoint = endpoint;
    for (int i = 0; i < kBulkTransfers; ++i) {
      libusb_transfer* transfer = add_transfer(0, bytes);
      libusb_fill_bulk_transfer(transfer, handle(), endpoint, transfer->buffer, transfer->length,
                                &on_bulk, state_.get(), 0);
    }
    submit_all();
  }

  void serve(double seconds) override {
    handle_events(seconds);
    if (state_->is_halted) {
      state_->is_halted = false;
      check(libusb_clear_halt(handle(), state_->endpoint));
      submit_all();
    }
    if (state_->is_gone) throw CameraUnavailable(name_ + " was unplugged");
  }

  void stop() override {
    state_->is_stopping = true;
    for (Transfer& transfer : state_->transfers) {
      if (transfer.is_submitted) libusb_cancel_transfer(transfer.handle);
    }
    using Clock = std::chrono::steady_clock;
    const auto end = Clock::now() + kStopTimeout;
    constexpr double kStep = 0.05;  // seconds
    while (state_->submitted() > 0 && Clock::now() < end) handle_events(kStep);
    if (state_->submitted() > 0) {
      // libusb may yet write there: kept for ever, and the device with it.
      new std::shared_ptr<State>(state_);
    }
    auto fresh = std::make_shared<State>();
    fresh->device = state_->device;
    fresh->is_gone = state_->is_gone;
    state_ = std::move(fresh);
  }

 private:
  struct Transfer {
    libusb_transfer* handle = nullptr;
    std::vector<std::uint8_t> buffer;
    bool is_submitted = false;
  };
  struct State {
    std::shared_ptr<Device> device;
    std::vector<Transfer> transfers;
    Sink sink;
    std::uint8_t endpoint = 0;
    bool is_stopping = false;
    bool is_gone = false;
    bool is_halted = false;

    State() = default;
    State(const State&) = delete;
    State& operator=(const State&) = delete;
    ~State() {
      for (Transfer& transfer : transfers) libusb_free_transfer(transfer.handle);
    }
    std::ptrdiff_t submitted() const {
      return std::count_if(transfers.begin(), transfers.end(),
                           [](const Transfer& transfer) { return transfer.is_submitted; });
    }
    Transfer& of(libusb_transfer* handle) {
      return *std::find_if(transfers.begin(), transfers.end(), [handle](const Transfer& transfer) {
        return transfer.handle == handle;
      });
    }
    void submit(Transfer& transfer) {
      const int result = libusb_submit_transfer(transfer.handle);
      transfer.is_submitted = result == 0;
      if (result != 0) is_gone = true;
    }
  };

  libusb_device_handle* handle() const { return state_->device->get(); }

  int control(std::uint8_t type, std::uint8_t request, std::uint16_t value, std::uint16_t index,
              std::uint8_t* data, std::size_t size) {
    const int result = libusb_control_transfer(handle(), type, request, value, index, data,
                                               static_cast<std::uint16_t>(size), kControlTimeout);
    if (result == LIBUSB_ERROR_NO_DEVICE) check(result);
    return result;
  }

  void check(int result) const {
    if (result == LIBUSB_ERROR_NO_DEVICE) {
      state_->is_gone = true;
      throw CameraUnavailable(name_ + " was unplugged");
    }
    if (result != 0) throw CameraUnavailable(name_ + ": " + libusb_strerror(result));
  }

  libusb_transfer* add_transfer(int packets, int bytes) {
    Transfer& transfer = state_->transfers.emplace_back();
    transfer.handle = libusb_alloc_transfer(packets);
    transfer.buffer.resize(static_cast<std::size_t>(bytes));
    transfer.handle->buffer = transfer.buffer.data();
    transfer.handle->length = bytes;
    return transfer.handle;
  }

  void submit_all() {
    for (Transfer& transfer : state_->transfers) {
      if (!transfer.is_submitted) state_->submit(transfer);
    }
  }

  void handle_events(double seconds) {
    constexpr double kMicroseconds = 1e6;
    timeval time{};
    time.tv_sec = static_cast<time_t>(seconds);
    time.tv_usec =
        static_cast<suseconds_t>((seconds - static_cast<double>(time.tv_sec)) * kMicroseconds);
    libusb_handle_events_timeout_completed(state_->device->context(), &time, nullptr);
  }

  // Whether the transfer is to be looked at; if not, it rests, or has been submitted again.
  static bool has_come(State& state, Transfer& transfer) {
    transfer.is_submitted = false;
    if (state.is_stopping) return false;
    switch (transfer.handle->status) {
      case LIBUSB_TRANSFER_COMPLETED:
        return true;
      case LIBUSB_TRANSFER_NO_DEVICE:
        state.is_gone = true;
        return false;
      case LIBUSB_TRANSFER_STALL:
        state.is_halted = true;  // serve() clears it, which cannot be done here
        state.sink({{}, false, true});
        return false;
      default:
        state.sink({{}, false, true});
        state.submit(transfer);
        return false;
    }
  }

  static void on_isochronous(libusb_transfer* handle) {
    auto& state = *static_cast<State*>(handle->user_data);
    Transfer& transfer = state.of(handle);
    if (!has_come(state, transfer)) return;
    for (int i = 0; i < handle->num_iso_packets; ++i) {
      const libusb_iso_packet_descriptor& packet = handle->iso_packet_desc[i];
      const std::uint8_t* data =
          libusb_get_iso_packet_buffer_simple(handle, static_cast<unsigned>(i));
      state.sink({{data, packet.actual_length}, false, packet.status != LIBUSB_TRANSFER_COMPLETED});
    }
    state.submit(transfer);
  }

  static void on_bulk(libusb_transfer* handle) {
    auto& state = *static_cast<State*>(handle->user_data);
    Transfer& transfer = state.of(handle);
    if (!has_come(state, transfer)) return;
    state.sink({{handle->buffer, static_cast<std::size_t>(handle->actual_length)},
                handle->actual_length < handle->length,
                false});
    state.submit(transfer);
  }

  std::shared_ptr<State> state_;
  std::string name_;
};

// Devices with a video interface, by their descriptors: nothing is opened for that.
std::vector<libusb_device*> video_devices(libusb_device** all) {
  std::vector<libusb_device*> found;
  for (; *all != nullptr; ++all) {
    libusb_config_descriptor* configuration = nullptr;
    if (libusb_get_active_config_descriptor(*all, &configuration) != 0) continue;
    bool is_video = false;
    for (int i = 0; i < configuration->bNumInterfaces; ++i) {
      const libusb_interface& interface = configuration->interface[i];
      is_video |= interface.num_altsetting > 0 &&
                  interface.altsetting[0].bInterfaceClass == LIBUSB_CLASS_VIDEO;
    }
    libusb_free_config_descriptor(configuration);
    if (is_video) found.push_back(*all);
  }
  return found;
}

// Calls `visit` with each camera's device until it returns true.
template <class Visit>
void for_each_camera(const std::shared_ptr<Context>& context, const Visit& visit) {
  libusb_device** list = nullptr;
  if (libusb_get_device_list(context->get(), &list) < 0) return;
  const auto free_list = [](libusb_device** devices) { libusb_free_device_list(devices, 1); };
  const std::unique_ptr<libusb_device*, decltype(free_list)> guard(list, free_list);
  for (libusb_device* device : video_devices(list)) {
    if (visit(device)) return;
  }
}

bool fits(libusb_device* device, const UvcCameraConfiguration& wanted) {
  constexpr int kHexadecimal = 16;
  libusb_device_descriptor is{};
  libusb_get_device_descriptor(device, &is);
  const auto fits = [](const std::string& digits, int value) {
    return digits.empty() || std::stoi(digits, nullptr, kHexadecimal) == value;
  };
  return fits(wanted.vendor, is.idVendor) && fits(wanted.product, is.idProduct);
}

std::string wanted_text(const UvcCameraConfiguration& wanted) {
  std::string text = "no USB camera";
  if (!wanted.vendor.empty()) text += " of vendor " + wanted.vendor;
  if (!wanted.product.empty()) text += ", product " + wanted.product;
  if (!wanted.serial.empty()) text += ", serial " + wanted.serial;
  return text + " is plugged in; uvc_camera --list shows what is there";
}

std::string interval_text(const UvcFrameSize& size) {
  std::string text;
  const auto rate = [](std::uint32_t interval) { return 1 / (interval * kUvcTick); };
  for (const std::uint32_t interval : size.intervals) {
    text += fmt::format(" {:.4g}", rate(interval));
  }
  if (size.intervals.empty() && size.shortest > 0) {
    text = fmt::format(" {:.4g} to {:.4g}", rate(size.longest), rate(size.shortest));
  }
  return text + " Hz";
}

}  // namespace

OpenedUsbCamera open_usb_camera(const UvcCameraConfiguration& wanted, bool reset) {
  const auto context = std::make_shared<Context>();
  OpenedUsbCamera opened;
  std::string problem;
  for_each_camera(context, [&](libusb_device* candidate) {
    if (!fits(candidate, wanted)) return false;
    try {
      const auto device = std::make_shared<Device>(context, candidate);
      if (!wanted.serial.empty() && device->serial() != wanted.serial) return false;
      if (reset && libusb_reset_device(device->get()) != 0) {
        throw CameraUnavailable(device->identity() + " comes back after a reset");
      }
      const std::vector<UvcFunction> functions = device->functions();
      const auto with_stream =
          std::find_if(functions.begin(), functions.end(),
                       [](const UvcFunction& function) { return !function.streams.empty(); });
      if (with_stream == functions.end()) return false;
      opened.function = *with_stream;
      opened.name = device->name();
      device->claim(opened.function.interface);
      for (const UvcStream& stream : opened.function.streams) device->claim(stream.interface);
      opened.transport = std::make_unique<LibusbTransport>(device, opened.name);
      return true;
    } catch (const std::runtime_error& why) {
      problem = why.what();
      return false;
    }
  });
  if (!opened.transport) throw CameraUnavailable(problem.empty() ? wanted_text(wanted) : problem);
  return opened;
}

std::string list_usb_cameras() {
  const auto context = std::make_shared<Context>();
  std::string text;
  for_each_camera(context, [&](libusb_device* candidate) {
    try {
      const auto device = std::make_shared<Device>(context, candidate);
      text += device->name() + "\n";
      LibusbTransport transport(device, device->name());
      for (const UvcFunction& function : device->functions()) {
        text += fmt::format("  UVC {:x}.{:02x}\n", function.version >> 8, function.version & 0xff);
        for (const UvcStream& stream : function.streams) {
          for (const UvcFormat& format : stream.formats) {
            for (const UvcFrameSize& size : format.sizes) {
              text += fmt::format("  {} {}x{} at{}\n", format.name, size.width, size.height,
                                  interval_text(size));
            }
          }
        }
        UsbCameraControls controls(transport, function);
        for (const std::string& line : describe_controls(controls)) text += "  " + line + "\n";
      }
    } catch (const std::runtime_error& why) {
      text += std::string("  ") + why.what() + "\n";
    }
    return false;
  });
  return text;
}

}  // namespace gastronaut

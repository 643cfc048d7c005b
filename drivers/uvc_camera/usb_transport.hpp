// A USB device as the camera's driver uses it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>

namespace gastronaut {

class UsbTransport {
 public:
  virtual ~UsbTransport() = default;
  // Class requests to the control pipe, answered or refused within a second. False: the device
  // refused (stalled) or did not answer. All functions throw CameraUnavailable when the device is
  // gone.
  virtual bool get(std::uint8_t request, std::uint16_t value, std::uint16_t index,
                   std::span<std::uint8_t> data) = 0;
  virtual bool set(std::uint8_t request, std::uint16_t value, std::uint16_t index,
                   std::span<const std::uint8_t> data) = 0;
  virtual void select_alternate(int interface, int setting) = 0;

  struct Received {
    std::span<const std::uint8_t> data;
    bool is_short = false;  // less than was asked for: the end of a bulk payload
    bool is_lost = false;   // the bus lost what should have been here
  };
  using Sink = std::function<void(const Received&)>;
  // Keeps asking `endpoint` for data; serve() hands over what came, a packet (isochronous) or a
  // transfer (bulk) a call.
  virtual void start_isochronous(std::uint8_t endpoint, int bytes, Sink sink) = 0;
  virtual void start_bulk(std::uint8_t endpoint, int bytes, Sink sink) = 0;
  virtual void serve(double seconds) = 0;
  // Takes back everything asked for; returns in bounded time whatever the device does.
  virtual void stop() = 0;
};

}  // namespace gastronaut

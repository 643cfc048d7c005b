// A raw SocketCAN socket: frames in with the kernel's receive time, frames out. Never blocks but in
// wait().
#pragma once

#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "can/can_frame.hpp"

namespace gastronaut {

// The interface is missing, down or gone; the message says which command mends it. Trying again
// later makes sense.
class CanUnavailable : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

class CanSocket {
 public:
  // Receives frames with these (identifier, extended), and error frames; none: receives nothing,
  // for a sender. Throws CanUnavailable, or std::runtime_error when this kernel has no CAN.
  CanSocket(const std::string& interface,
            const std::vector<std::pair<std::uint32_t, bool>>& identifiers);
  ~CanSocket();
  CanSocket(const CanSocket&) = delete;
  CanSocket& operator=(const CanSocket&) = delete;

  // Until a frame is there, something happened to the interface, or `seconds` have passed.
  void wait(double seconds) const;

  struct Received {
    CanFrame frame;  // utime: the kernel's, when it was received
    // By the adapter's own clock, microseconds; nothing: it does not give its time.
    std::optional<std::int64_t> device_utime;
  };
  // The next frame, nothing when there is none. Throws CanUnavailable when the interface is gone
  // and the last frame that it received has been handed out.
  std::optional<Received> receive();
  // Frames lost since the start because this program did not fetch them in time.
  std::int64_t dropped() const { return dropped_; }

  // False when the interface's queue stayed full for 0.1 s and the frame was not sent. Throws
  // CanUnavailable.
  bool send(const CanFrame& frame);

 private:
  [[noreturn]] void unavailable(int error) const;

  std::string interface_;
  int socket_ = -1;
  int epoll_ = -1;
  int broken_ = 0;  // errno of the interface's end
  std::int64_t dropped_ = 0;
  std::uint32_t kernel_dropped_ = 0;  // its counter, which wraps
};

}  // namespace gastronaut

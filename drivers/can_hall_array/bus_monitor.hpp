// What a CAN controller says of its bus in error frames (linux/can/error.h), and what that means to
// whoever has to mend it. A controller that made too many errors goes from active to passive to
// bus-off, where it neither sends nor hears until it is restarted.
#pragma once

#include <cstdint>
#include <string>

#include "can/can_frame.hpp"

namespace gastronaut {

class BusMonitor {
 public:
  enum class State { kActive, kWarning, kPassive, kBusOff };
  struct Counters {
    std::int64_t error_frames = 0;
    std::int64_t protocol_errors = 0;  // bits, stuffing, form, CRC
    std::int64_t overflows = 0;        // the controller lost frames that it had received
    std::int64_t bus_offs = 0;
    std::int64_t recoveries = 0;  // from bus-off
  };

  void handle(const CanFrame& error_frame);
  // A frame of data came: the bus works.
  void heard();
  // The interface went down and came up: its controller begins without errors.
  void started();

  State state() const { return state_; }
  const Counters& counters() const { return counters_; }
  // What is wrong and what to do about it; empty: nothing.
  std::string describe(const std::string& interface) const;

 private:
  void enter(State state);

  State state_ = State::kActive;
  Counters counters_;
};

}  // namespace gastronaut

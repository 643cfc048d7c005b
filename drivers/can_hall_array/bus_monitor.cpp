#include "can_hall_array/bus_monitor.hpp"

#include <linux/can/error.h>

namespace gastronaut {

void BusMonitor::enter(State state) {
  if (state == State::kBusOff && state_ != State::kBusOff) ++counters_.bus_offs;
  if (state != State::kBusOff && state_ == State::kBusOff) ++counters_.recoveries;
  state_ = state;
}

void BusMonitor::handle(const CanFrame& error_frame) {
  ++counters_.error_frames;
  const std::uint32_t classes = error_frame.id;
  const std::uint8_t controller = error_frame.data[1];
  if ((classes & (CAN_ERR_PROT | CAN_ERR_BUSERROR)) != 0) ++counters_.protocol_errors;
  if ((classes & CAN_ERR_RESTARTED) != 0) enter(State::kActive);
  if ((classes & CAN_ERR_CRTL) != 0) {
    if ((controller & CAN_ERR_CRTL_RX_OVERFLOW) != 0) ++counters_.overflows;
    if ((controller & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0) {
      enter(State::kPassive);
    } else if ((controller & (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)) != 0) {
      enter(State::kWarning);
    } else if ((controller & CAN_ERR_CRTL_ACTIVE) != 0) {
      enter(State::kActive);
    }
  }
  if ((classes & CAN_ERR_BUSOFF) != 0) enter(State::kBusOff);
}

void BusMonitor::heard() {
  // Passive controllers hear, too: only the end of bus-off is proven.
  if (state_ == State::kBusOff) enter(State::kActive);
}

void BusMonitor::started() { enter(State::kActive); }

std::string BusMonitor::describe(const std::string& interface) const {
  switch (state_) {
    case State::kBusOff:
      return interface +
             " is bus-off; check wiring, termination and bit rate, then: sudo ip link " + "set " +
             interface + " down && sudo ip link set " + interface +
             " up (restart-ms 100 does that by itself)";
    case State::kPassive:
      return interface +
             " is error-passive: many frames are damaged; check wiring, termination and bit rate";
    case State::kWarning:
      return interface + " counts errors; check wiring, termination and bit rate";
    default:
      return "";
  }
}

}  // namespace gastronaut

// The Hall array on the bus: frames off a CAN bus become HALL_ARRAY and COIL_CURRENTS.
#pragma once

#include <array>
#include <cstdint>
#include <string>

#include "bus/bus.hpp"
#include "can/can_frame.hpp"
#include "can/hall_array_layout.hpp"
#include "can_hall_array/bus_monitor.hpp"
#include "can_hall_array/cycle_assembler.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

class CanHallArrayProcess {
 public:
  CanHallArrayProcess(Bus& bus, const RigConfiguration& rig, HallArrayLayout layout);
  CanHallArrayProcess(const CanHallArrayProcess&) = delete;
  CanHallArrayProcess& operator=(const CanHallArrayProcess&) = delete;

  // Frames in the order in which they were received. Publishes what becomes complete or due: an
  // axis that has not come is NaN and its sensor STALE; currents that are not all there are not
  // published, their number is missing.
  void handle(const CanFrame& frame);
  // The interface has come up.
  void start_listening() { monitor_.started(); }
  // It is `utime` now, and every frame received before has been handled.
  void advance(std::int64_t utime);
  // Publishes what is still held back.
  void finish();

  const HallArrayLayout& layout() const { return layout_; }
  const BusMonitor& monitor() const { return monitor_; }
  const CycleAssembler::Counters& counters(CanStream stream) const;
  std::int64_t frames() const { return frames_; }        // of this array
  std::int64_t malformed() const { return malformed_; }  // of these, without a reading in them

  struct Health {
    ProcessState state;
    std::string message;
  };
  // How it went since the last call; `dropped` frames were lost in this program's queue so far.
  Health report(std::int64_t dropped);

 private:
  void publish_field(const CycleAssembler::Reading& reading);
  void publish_currents(const CycleAssembler::Reading& reading);
  void publish_configuration(std::int64_t utime);
  CycleAssembler make_assembler(CanStream stream);
  CycleAssembler& assembler(CanStream stream) {
    return assemblers_[static_cast<std::size_t>(stream)];
  }

  // What report() has told of.
  struct Told {
    std::int64_t frames = 0;
    std::int64_t incomplete = 0;
    std::int64_t lost = 0;
    std::int64_t dropped = 0;
    std::int64_t malformed = 0;
    std::int64_t overflows = 0;
    std::int64_t restarts = 0;
    std::int64_t errors = 0;
  };
  Told now(std::int64_t dropped) const;

  Bus& bus_;
  RigConfiguration rig_;
  HallArrayLayout layout_;
  std::array<CycleAssembler, kNumCanStreams> assemblers_;
  BusMonitor monitor_;
  HallArrayLayout::Contribution contribution_;
  std::int64_t frames_ = 0;
  std::int64_t malformed_ = 0;
  std::int64_t configuration_due_ = 0;  // utime
  Told told_;
};

}  // namespace gastronaut

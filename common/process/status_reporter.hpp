// PROCESS_STATUS, once a second; systemd, where it started this process, hears the same.
#pragma once

#include <chrono>
#include <string>

#include "bus/lcm_bus.hpp"
#include "gastronaut/process_status_t.hpp"

namespace gastronaut {

class StatusReporter {
 public:
  StatusReporter(LcmBus& bus, const std::string& name);

  // Whether a second has passed since the last status.
  bool due() const;
  // To be called several times a second; publishes when due. Counters and health are the bus's,
  // unless a driver, whose input comes from elsewhere, gives its own.
  void tick() { tick(bus_.counters(), bus_.state(), bus_.describe_health()); }
  void tick(const BusCounters& counters, ProcessState state, const std::string& message);

 private:
  LcmBus& bus_;
  process_status_t status_{};
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
  double last_cpu_ = 0;
};

}  // namespace gastronaut

// Times that a device took by its own clock, in the host's time. The device's are even, the
// host's come late by whatever the host was busy with: the offset between the two is the smallest
// ever seen, allowed to grow as slowly as clocks drift, so that mapped times neither jump nor
// inherit the host's delays. Where one of the clocks was set, it is followed within two seconds.
#pragma once

#include <cstdint>
#include <optional>

namespace gastronaut {

class DeviceClock {
 public:
  // When the device's `device` (microseconds) was in the host's time, given that the host had
  // received it by `host`. Never later than `host`, never earlier than any answer before.
  std::int64_t to_host(std::int64_t device, std::int64_t host);

 private:
  void start_window(std::int64_t device);

  std::optional<std::int64_t> last_device_;
  double offset_ = 0;  // microseconds, host minus device
  std::int64_t last_answer_ = 0;
  std::int64_t window_end_ = 0;  // device time
  double least_lag_ = 0;         // microseconds in this window, of an answer to the host's time
};

}  // namespace gastronaut

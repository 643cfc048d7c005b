#include "clock/device_clock.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gastronaut {
namespace {

constexpr double kDrift = 1e-4;            // of two quartz clocks, at most
constexpr std::int64_t kStep = 1'000'000;  // microseconds: one of the clocks was set
// Nothing within so little for so long: the host's clock was set forward, or the device's does not
// run as fast as it says.
constexpr double kMostLag = 5000;            // microseconds
constexpr std::int64_t kWindow = 1'000'000;  // microseconds

}  // namespace

std::int64_t DeviceClock::to_host(std::int64_t device, std::int64_t host) {
  const double seen = static_cast<double>(host) - static_cast<double>(device);
  const bool was_set = !last_device_ || std::abs(seen - offset_) > static_cast<double>(kStep) ||
                       device < *last_device_ - kStep;
  if (was_set) {
    offset_ = seen;
    last_answer_ = host;
    start_window(device);
  } else {
    const auto elapsed = static_cast<double>(std::max<std::int64_t>(0, device - *last_device_));
    offset_ = std::min(seen, offset_ + kDrift * elapsed);
    least_lag_ = std::min(least_lag_, seen - offset_);
    if (device >= window_end_) {
      if (least_lag_ > kMostLag) offset_ += least_lag_;
      start_window(device);
    }
  }
  last_device_ = device;
  const auto mapped =
      static_cast<std::int64_t>(std::llround(static_cast<double>(device) + offset_));
  last_answer_ = std::clamp(mapped, std::min(last_answer_, host), host);
  return last_answer_;
}

void DeviceClock::start_window(std::int64_t device) {
  window_end_ = device + kWindow;
  least_lag_ = std::numeric_limits<double>::infinity();
}

}  // namespace gastronaut

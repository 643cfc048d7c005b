#include "clock/device_clock.hpp"

#include <algorithm>
#include <cmath>

namespace gastronaut {
namespace {

constexpr double kDrift = 1e-4;            // of two quartz clocks, at most
constexpr std::int64_t kStep = 1'000'000;  // microseconds: one of the clocks was set

}  // namespace

std::int64_t DeviceClock::to_host(std::int64_t device, std::int64_t host) {
  const double seen = static_cast<double>(host) - static_cast<double>(device);
  const bool was_set = !last_device_ || std::abs(seen - offset_) > static_cast<double>(kStep) ||
                       device < *last_device_ - kStep;
  if (was_set) {
    offset_ = seen;
    last_answer_ = host;
  } else {
    const auto elapsed = static_cast<double>(std::max<std::int64_t>(0, device - *last_device_));
    offset_ = std::min(seen, offset_ + kDrift * elapsed);
  }
  last_device_ = device;
  const auto mapped =
      static_cast<std::int64_t>(std::llround(static_cast<double>(device) + offset_));
  last_answer_ = std::clamp(mapped, std::min(last_answer_, host), host);
  return last_answer_;
}

}  // namespace gastronaut

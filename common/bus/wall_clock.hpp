// The wall clock as a utime: for live transports and drivers. Nothing that ends in a derived log
// may depend on it.
#pragma once

#include <chrono>
#include <cstdint>

namespace gastronaut {

// Microseconds since the epoch.
inline std::int64_t wall_utime() {
  return std::chrono::duration_cast<std::chrono::microseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

}  // namespace gastronaut

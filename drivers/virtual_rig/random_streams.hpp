// Streams of the scenario's random numbers, one for each thing that is drawn: switching one off
// leaves all the others as they were.
#pragma once

#include <cstdint>

namespace gastronaut {

enum class RandomStream : std::uint64_t {
  kSensorErrors = 1,
  kMomentError,
  kMatrixError,
  kCurrentWaves,
  kCurrentNoise,
  kHallNoise,
  kTrajectory,
  kVessels,
  kImageNoise,
  kLostMessages,
};

// Sub-stream n (a picture, a channel) of a stream.
constexpr std::uint64_t stream_id(RandomStream stream, std::uint64_t n = 0) {
  return (static_cast<std::uint64_t>(stream) << 40) + n;
}

}  // namespace gastronaut

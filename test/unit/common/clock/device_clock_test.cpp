#include "clock/device_clock.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace gastronaut {
namespace {

constexpr std::int64_t kPeriod = 5000;  // microseconds
constexpr std::int64_t kHostStart = 1'700'000'000'000'000;
constexpr double kDrift = 5e-5;         // of the device's clock, a bad quartz
constexpr double kMeanDelay = 300;      // microseconds until the host has a frame
constexpr std::int64_t kSettled = 200;  // frames: a second

TEST(DeviceClock, MappedTimesAreEvenWhereTheHostsAreNot) {
  std::mt19937 random(1);
  std::exponential_distribution<double> delay(1 / kMeanDelay);
  DeviceClock clock;
  double worst_step = 0;
  double worst_error = 0;
  std::int64_t last = 0;
  for (std::int64_t frame = 0; frame < 12'000; ++frame) {  // a minute
    const std::int64_t truth = kHostStart + frame * kPeriod;
    const auto device = static_cast<std::int64_t>(
        std::llround(static_cast<double>(frame * kPeriod) * (1 + kDrift)));
    const auto host = truth + static_cast<std::int64_t>(delay(random));
    const std::int64_t mapped = clock.to_host(device, host);
    EXPECT_LE(mapped, host);
    EXPECT_GE(mapped, last);
    if (frame > kSettled) {
      worst_step = std::max(worst_step, std::abs(static_cast<double>(mapped - last - kPeriod)));
      worst_error = std::max(worst_error, std::abs(static_cast<double>(mapped - truth)));
    }
    last = mapped;
  }
  // The host's own steps are off by ten times the mean delay now and then. The offset moves by the
  // least delay of the last second or so (a two-hundredth of the mean) and by the drift allowed.
  constexpr double kLargestStep = 50;  // microseconds
  constexpr double kLargestError = 100;
  EXPECT_LT(worst_step, kLargestStep);
  EXPECT_LT(worst_error, kLargestError);
}

TEST(DeviceClock, AClockThatWasSetIsFollowedAtOnce) {
  DeviceClock clock;
  EXPECT_EQ(clock.to_host(1000, kHostStart), kHostStart);
  // The adapter was plugged in again: its clock begins anew.
  EXPECT_EQ(clock.to_host(50'000'000, kHostStart + 1'000'000), kHostStart + 1'000'000);
  constexpr std::int64_t kHour = 3'600'000'000;
  EXPECT_EQ(clock.to_host(50'005'000, kHostStart - kHour), kHostStart - kHour);
  EXPECT_EQ(clock.to_host(50'010'000, kHostStart - kHour + kPeriod), kHostStart - kHour + kPeriod);
}

TEST(DeviceClock, AHostsClockThatWasSetForwardIsFollowedWithinTwoSeconds) {
  constexpr std::int64_t kForward = 500'000;     // microseconds: too little to be seen at once
  constexpr std::int64_t kPatience = 2'000'000;  // microseconds
  constexpr std::int64_t kLargestError = 1000;   // microseconds
  DeviceClock clock;
  for (std::int64_t time = 0; time < 20 * kPatience; time += kPeriod) {
    const std::int64_t host = kHostStart + time + (time >= 10 * kPatience ? kForward : 0);
    const std::int64_t mapped = clock.to_host(time, host);
    EXPECT_LE(mapped, host);
    if (time >= 11 * kPatience) {
      EXPECT_LE(host - mapped, kLargestError);
    }
  }
}

}  // namespace
}  // namespace gastronaut

#include "can_hall_array/can_hall_array_process.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <linux/can/error.h>

#include <cmath>
#include <gastronaut/coil_currents_t.hpp>
#include <gastronaut/hall_array_t.hpp>
#include <gastronaut/rig_config_t.hpp>

#include "bus/memory_bus.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr std::int64_t kStart = 1'700'000'000'000'000;
constexpr std::int64_t kPeriod = 10'000;  // microseconds, hall_array.rate of the default rig
constexpr std::int64_t kFrameGap = 200;
constexpr double kCount = 2e-7;  // tesla

class CanHallArrayProcessTest : public ::testing::Test {
 protected:
  CanHallArrayProcessTest()
      : network_([this](const std::string& channel, Bytes payload, std::int64_t) {
          if (channel == channel::kHallArray) decode_message(payload, readings_.emplace_back());
          if (channel == channel::kCoilCurrents) decode_message(payload, currents_.emplace_back());
          if (channel == channel::kRigConfig) {
            decode_message(payload, configurations_.emplace_back());
          }
        }),
        layout_(load_hall_array_layout(rig_, {GASTRONAUT_SOURCE_DIR "/config/any.yaml"})),
        process_(network_.connect(), rig_, layout_) {}

  // Frames of reading `seq`: every channel has `counts` counts.
  std::vector<CanFrame> reading(std::int64_t seq, int counts, int status = 0) const {
    std::vector<double> values(layout_.num_values(CanStream::kField), counts * kCount);
    for (std::size_t i = layout_.status_place(0); i < values.size(); ++i) values[i] = status;
    return at(seq, layout_.encode(CanStream::kField, static_cast<std::uint64_t>(seq), values));
  }
  std::vector<CanFrame> at(std::int64_t seq, std::vector<CanFrame> frames) const {
    for (std::size_t i = 0; i < frames.size(); ++i) {
      frames[i].utime = kStart + seq * kPeriod + static_cast<std::int64_t>(i) * kFrameGap;
    }
    return frames;
  }
  void handle(const std::vector<CanFrame>& frames) {
    for (const CanFrame& frame : frames) process_.handle(frame);
  }

  RigConfiguration rig_;
  std::vector<hall_array_t> readings_;
  std::vector<coil_currents_t> currents_;
  std::vector<rig_config_t> configurations_;
  MemoryNetwork network_;
  HallArrayLayout layout_;
  CanHallArrayProcess process_;
};

TEST_F(CanHallArrayProcessTest, ReadingsHaveTheTimeAndNumberOfTheirFrames) {
  handle(reading(41, 5));
  handle(reading(42, -7));
  ASSERT_EQ(readings_.size(), 2U);
  EXPECT_EQ(readings_[1].utime, kStart + 42 * kPeriod);
  EXPECT_EQ(readings_[1].seq, 42);
  EXPECT_EQ(readings_[1].num_sensors, 64);
  EXPECT_EQ(readings_[1].num_axes, 3);
  for (const std::vector<float>& sensor : readings_[1].field) {
    EXPECT_THAT(sensor, ::testing::Each(static_cast<float>(-7 * kCount)));
  }
  EXPECT_THAT(readings_[1].status, ::testing::Each(hall_array_t::STATUS_OK));
}

TEST_F(CanHallArrayProcessTest, SensorsOfALostFrameAreStaleAndHaveNoField) {
  handle(reading(1, 5));
  std::vector<CanFrame> frames = reading(2, 6);
  frames.erase(frames.begin() + 3);  // sensors 24 to 31
  handle(frames);
  handle(reading(3, 7));
  handle(reading(4, 8));
  ASSERT_EQ(readings_.size(), 4U);
  for (std::size_t sensor = 0; sensor < 64; ++sensor) {
    const bool lost = sensor >= 24 && sensor < 32;
    EXPECT_EQ(readings_[1].status[sensor] == hall_array_t::STATUS_STALE, lost);
    EXPECT_EQ(readings_[1].status[sensor] == hall_array_t::STATUS_OK, !lost);
    for (const float field : readings_[1].field[sensor]) {
      EXPECT_EQ(std::isnan(field), lost) << sensor;
    }
    EXPECT_EQ(readings_[2].status[sensor], hall_array_t::STATUS_OK);
  }
  EXPECT_THAT(process_.report(0).message, HasSubstr("1 readings with frames missing"));
}

TEST_F(CanHallArrayProcessTest, AReadingThatIsNotFinishedComesOutAfterTheTimeout) {
  std::vector<CanFrame> frames = reading(1, 5);
  frames.pop_back();
  handle(frames);
  EXPECT_TRUE(readings_.empty());
  const auto timeout = static_cast<std::int64_t>(rig_.can_hall_array.timeout * 1e6);
  process_.advance(frames[0].utime + timeout + 1);
  ASSERT_EQ(readings_.size(), 1U);
  EXPECT_EQ(readings_[0].status.back(), hall_array_t::STATUS_STALE);
}

TEST_F(CanHallArrayProcessTest, StatusIsTheArraysAndSaturationOurs) {
  handle(reading(1, 5, hall_array_t::STATUS_FAULT));
  const int saturated = static_cast<int>(std::lround(rig_.hall_array.saturation / kCount));
  handle(reading(2, saturated));
  handle(reading(3, 1 - saturated));
  ASSERT_EQ(readings_.size(), 3U);
  EXPECT_THAT(readings_[0].status, ::testing::Each(hall_array_t::STATUS_FAULT));
  EXPECT_THAT(readings_[1].status, ::testing::Each(hall_array_t::STATUS_SATURATED));
  EXPECT_THAT(readings_[2].status, ::testing::Each(hall_array_t::STATUS_OK));
}

TEST_F(CanHallArrayProcessTest, CurrentsAreAllThereOrNotAtAll) {
  RigConfiguration rig = rig_;
  rig.can_hall_array.dbc = "hall_array_classic.dbc";  // two coils a frame
  const HallArrayLayout classic =
      load_hall_array_layout(rig, {GASTRONAUT_SOURCE_DIR "/config/any.yaml"});
  CanHallArrayProcess process(network_.connect(), rig, classic);
  std::vector<double> sent;
  for (int coil = 0; coil < 9; ++coil) sent.push_back(coil - 4.0);
  for (std::int64_t seq = 1; seq <= 4; ++seq) {
    std::vector<CanFrame> frames =
        at(seq, classic.encode(CanStream::kCurrents, static_cast<std::uint64_t>(seq), sent));
    if (seq == 2) frames.erase(frames.begin());
    for (const CanFrame& frame : frames) process.handle(frame);
  }
  process.finish();
  ASSERT_EQ(currents_.size(), 3U);
  EXPECT_EQ(currents_[0].seq, 1);
  EXPECT_EQ(currents_[1].seq, 3);
  EXPECT_EQ(currents_[1].utime, kStart + 3 * kPeriod);
  for (std::size_t coil = 0; coil < 9; ++coil) {
    EXPECT_FLOAT_EQ(currents_[1].current[coil], static_cast<float>(sent[coil]));
  }
}

TEST_F(CanHallArrayProcessTest, TheConfigurationGoesOutAtTheStartAndEveryTenSeconds) {
  process_.advance(kStart);
  for (std::int64_t seq = 0; seq < 2100; ++seq) handle(reading(seq, 1));  // 21 s
  ASSERT_EQ(configurations_.size(), 3U);
  EXPECT_EQ(configurations_[1].utime - configurations_[0].utime, 10'000'000);
  EXPECT_EQ(parse_rig_configuration(configurations_[0].yaml, "RIG_CONFIG").can_hall_array.dbc,
            rig_.can_hall_array.dbc);
}

TEST_F(CanHallArrayProcessTest, HealthNamesWhatIsWrongAndForgetsWhatIsOver) {
  EXPECT_THAT(process_.report(0).message,
              AllOf(HasSubstr("nothing comes"), HasSubstr("link show can0")));
  handle(reading(1, 5));
  EXPECT_EQ(process_.report(0).state, ProcessState::kRunning);
  EXPECT_EQ(process_.report(0).state, ProcessState::kDegraded);
  handle(reading(2, 5));
  EXPECT_THAT(process_.report(12).message, HasSubstr("12 frames lost because"));
  handle(reading(6, 5));
  CanFrame tiny = reading(7, 5).front();
  tiny.length = 8;
  process_.handle(tiny);
  EXPECT_THAT(process_.report(12).message,
              AllOf(HasSubstr("3 readings did not come"), HasSubstr("1 frames too short")));
  CanFrame bus_off;
  bus_off.error = true;
  bus_off.id = CAN_ERR_BUSOFF;
  process_.handle(bus_off);
  const CanHallArrayProcess::Health health = process_.report(12);
  EXPECT_EQ(health.state, ProcessState::kDegraded);
  EXPECT_THAT(health.message, HasSubstr("can0 is bus-off"));
  handle(reading(7, 5));
  EXPECT_EQ(process_.report(12).message, "");
}

}  // namespace
}  // namespace gastronaut

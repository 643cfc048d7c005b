#include "bus/memory_bus.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gastronaut {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr double kLagSeconds = 1e-3;

hall_array_t reading(std::int64_t utime, int seq) {
  hall_array_t message{};
  message.utime = utime;
  message.seq = seq;
  return message;
}

coil_currents_t currents(std::int64_t utime, int seq) {
  coil_currents_t message{};
  message.utime = utime;
  message.seq = seq;
  return message;
}

class MemoryBusTest : public ::testing::Test {
 protected:
  MemoryBusTest() {
    bus_.subscribe<coil_currents_t>("COIL_CURRENTS", kLagSeconds, [this](const auto& m) {
      handled_.push_back("coils " + std::to_string(m.utime));
    });
    bus_.subscribe<hall_array_t>("HALL_ARRAY", kLagSeconds, [this](const auto& m) {
      EXPECT_EQ(bus_.event_utime(), m.utime);
      handled_.push_back("hall " + std::to_string(m.utime));
    });
  }
  template <class Message>
  void inject(const std::string& channel, const Message& message) {
    network_.inject(channel, encode_message(message));
    network_.run_until_idle();
  }

  MemoryNetwork network_;
  Bus& bus_ = network_.connect();
  std::vector<std::string> handled_;
};

TEST_F(MemoryBusTest, HandlersAreCalledInTheOrderOfUtime) {
  inject("HALL_ARRAY", reading(20, 0));
  inject("COIL_CURRENTS", currents(10, 0));
  inject("COIL_CURRENTS", currents(20, 1));
  EXPECT_THAT(handled_, ElementsAre("coils 10", "coils 20", "hall 20"));
}

TEST_F(MemoryBusTest, CorruptAndForeignMessagesAreCountedNamedAndDropped) {
  auto cut = encode_message(reading(1, 0));
  cut.pop_back();
  network_.inject("HALL_ARRAY", cut);
  inject("HALL_ARRAY", currents(1, 0));
  EXPECT_EQ(bus_.counters().corrupt, 1);
  EXPECT_EQ(bus_.counters().foreign, 1);
  EXPECT_EQ(bus_.counters().received, 2);
  EXPECT_THAT(bus_.describe_health(), HasSubstr("HALL_ARRAY: 2 corrupt or foreign"));
}

TEST_F(MemoryBusTest, GapsInSequenceNumbersAreLost) {
  inject("HALL_ARRAY", reading(1, 0));
  inject("HALL_ARRAY", reading(2, 1));
  inject("HALL_ARRAY", reading(5, 4));
  EXPECT_EQ(bus_.counters().lost, 2);
  inject("HALL_ARRAY", reading(6, 0));
  EXPECT_EQ(bus_.counters().lost, 2);
}

TEST(MemoryBus, GapsInThePicturesNumbersAreLostToo) {
  MemoryNetwork network;
  Bus& bus = network.connect();
  bus.subscribe<image_t>("CAMERA", kLagSeconds, [](const image_t&) {});
  std::int64_t utime = 0;
  // A picture without a number, or with nonsense for one, says nothing.
  for (const char* seq : {"7", "8", "", "nonsense", "9223372036854775807", "-3", "11", "12"}) {
    image_t picture{};
    picture.utime = ++utime;
    const std::string text = seq;
    picture.nmetadata = 1;
    picture.metadata.resize(1);
    picture.metadata[0].key = text.empty() ? "exposure_us" : "seq";
    picture.metadata[0].value.assign(text.begin(), text.end());
    picture.metadata[0].n = static_cast<std::int32_t>(text.size());
    network.inject("CAMERA", encode_message(picture));
    network.run_until_idle();
  }
  EXPECT_EQ(bus.counters().lost, 2);
}

TEST_F(MemoryBusTest, SilentInputIsNamed) {
  inject("HALL_ARRAY", reading(0, 0));
  inject("HALL_ARRAY", reading(1001, 1));
  EXPECT_THAT(bus_.describe_health(), HasSubstr("COIL_CURRENTS is silent"));
  EXPECT_THAT(handled_, ElementsAre("hall 0", "hall 1001"));
}

TEST(MemoryNetwork, WhatOneProcessPublishesTheNextOneHandles) {
  std::vector<std::string> sink;
  MemoryNetwork network([&](const std::string& channel, Bytes, std::int64_t utime) {
    sink.push_back(channel + " " + std::to_string(utime));
  });
  Bus& first = network.connect();
  Bus& second = network.connect();
  first.subscribe<hall_array_t>("HALL_ARRAY", kLagSeconds, [&](const hall_array_t& m) {
    magnetic_pose_t pose{};
    pose.utime = m.utime;
    first.publish("MAGNETIC_POSE", pose);
  });
  int finished = 0;
  second.subscribe<magnetic_pose_t>("MAGNETIC_POSE", kLagSeconds, [&](const magnetic_pose_t& m) {
    pose_t pose{};
    pose.utime = m.utime;
    second.publish("CAPSULE_POSE", pose);
  });
  network.inject("HALL_ARRAY", encode_message(reading(10, 0)));
  network.run_until_idle();
  EXPECT_THAT(sink, ElementsAre("MAGNETIC_POSE 10", "CAPSULE_POSE 10"));
  network.finish([&](std::size_t) { ++finished; });
  EXPECT_EQ(finished, 2);
}

TEST_F(MemoryBusTest, FinishHandlesWhatWasWaiting) {
  network_.inject("HALL_ARRAY", encode_message(reading(10, 0)));
  network_.run_until_idle();
  EXPECT_TRUE(handled_.empty());
  network_.finish([](std::size_t) {});
  EXPECT_THAT(handled_, ElementsAre("hall 10"));
}

}  // namespace
}  // namespace gastronaut

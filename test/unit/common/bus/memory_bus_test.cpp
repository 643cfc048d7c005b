#include "bus/memory_bus.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

namespace gastronaut {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

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

// One process asks with MAGNETIC_POSE, another answers with CAPSULE_POSE once it has heard the
// coils.
class FeedbackLoopTest : public ::testing::Test {
 protected:
  static constexpr double kAskerLag = 1e-3;
  static constexpr double kAnswererLag = 2e-3;  // the longer: it waits for more than the asker does

  FeedbackLoopTest() {
    asker_.subscribe<hall_array_t>("HALL_ARRAY", kAskerLag, [this](const hall_array_t& m) {
      said_.push_back("ask " + std::to_string(m.utime));
      magnetic_pose_t question{};
      question.utime = m.utime;
      asker_.publish("MAGNETIC_POSE", question);
      if (!asker_.await("CAPSULE_POSE", m.utime)) said_.push_back("alone");
    });
    asker_.subscribe_feedback<pose_t>("CAPSULE_POSE", kAskerLag, [this](const pose_t& m) {
      said_.push_back("answer " + std::to_string(m.utime));
    });
    answerer_.subscribe<coil_currents_t>("COIL_CURRENTS", kAnswererLag, [](const auto&) {});
    answerer_.subscribe<magnetic_pose_t>("MAGNETIC_POSE", kAnswererLag, [this](const auto& m) {
      pose_t answer{};
      answer.utime = m.utime;
      answerer_.publish("CAPSULE_POSE", answer);
    });
  }
  void hear(std::int64_t utime) {
    network_.inject("COIL_CURRENTS", encode_message(currents(utime, 0)));
    network_.run_until_idle();
  }
  void see(std::int64_t utime) {
    network_.inject("HALL_ARRAY", encode_message(reading(utime, 0)));
    network_.run_until_idle();
  }

  MemoryNetwork network_;
  Bus& asker_ = network_.connect();
  Bus& answerer_ = network_.connect();
  std::vector<std::string> said_;
};

TEST_F(FeedbackLoopTest, AnswerComesBeforeTheNextEvent) {
  see(100);
  see(200);
  EXPECT_THAT(asker_.describe_health(), HasSubstr("waiting for CAPSULE_POSE"));
  hear(300);
  see(300);
  EXPECT_THAT(said_, ElementsAre("ask 100", "answer 100", "ask 200", "answer 200", "ask 300",
                                 "answer 300"));
  EXPECT_EQ(asker_.counters().late, 0);
}

// Each of the two waits for the other or for an input that has died; neither for ever.
TEST_F(FeedbackLoopTest, SilentInputOfTheOtherProcessHoldsUpNobodyForLong) {
  hear(0);
  for (std::int64_t utime = 100; utime <= 5000; utime += 100) see(utime);
  EXPECT_EQ(said_.back(), "answer 5000");
  EXPECT_THAT(asker_.describe_health(), Not(HasSubstr("CAPSULE_POSE")));
  EXPECT_GT(std::count(said_.begin(), said_.end(), "alone"), 0);
  const auto is_question = [](const std::string& text) { return text.starts_with("ask"); };
  EXPECT_EQ(std::count_if(said_.begin(), said_.end(), is_question), 50);
}

TEST_F(FeedbackLoopTest, ProcessThatNobodyAnswersGoesOnAloneAndSaysSo) {
  MemoryNetwork network;
  Bus& bus = network.connect();
  int handled = 0;
  bus.subscribe<hall_array_t>("HALL_ARRAY", kAskerLag, [&](const hall_array_t& m) {
    ++handled;
    bus.await("CAPSULE_POSE", m.utime);
  });
  bus.subscribe_feedback<pose_t>("CAPSULE_POSE", kAskerLag, [](const pose_t&) { FAIL(); });
  for (std::int64_t utime = 0; utime <= 3000; utime += 500) {
    network.inject("HALL_ARRAY", encode_message(reading(utime, 0)));
    network.run_until_idle();
  }
  EXPECT_EQ(handled, 7);
  EXPECT_THAT(bus.describe_health(), HasSubstr("CAPSULE_POSE is silent"));
}

TEST_F(FeedbackLoopTest, EndOfALogHoldsUpNothing) {
  for (std::int64_t utime = 100; utime <= 500; utime += 100) {
    network_.inject("HALL_ARRAY", encode_message(reading(utime, 0)));
  }
  network_.run_until_idle();
  EXPECT_THAT(said_, ElementsAre("ask 100"));
  network_.finish([](std::size_t) {});
  EXPECT_EQ(std::count(said_.begin(), said_.end(), "ask 500"), 1);
  EXPECT_EQ(asker_.pending() + answerer_.pending(), 0U);
}

}  // namespace
}  // namespace gastronaut

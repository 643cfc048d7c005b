#include "bus/event_order.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gastronaut {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using PushResult = EventOrder::PushResult;

constexpr std::int64_t kLag = 100;

class EventOrderTest : public ::testing::Test {
 protected:
  PushResult push(int input, std::int64_t utime) {
    return order_.push(input, utime, [this, input, utime] { handled_.emplace_back(input, utime); });
  }
  std::vector<std::pair<int, std::int64_t>> handle_ready() {
    handled_.clear();
    while (auto event = order_.pop()) event->handle();
    return handled_;
  }
  std::vector<std::pair<int, std::int64_t>> handle_all() {
    handled_.clear();
    while (auto event = order_.drain()) event->handle();
    return handled_;
  }

  EventOrder order_;
  int coils_ = order_.add_input("coils", kLag);
  int hall_ = order_.add_input("hall", kLag);
  std::vector<std::pair<int, std::int64_t>> handled_;
};

TEST_F(EventOrderTest, WaitsUntilEveryInputHasPassedAndNamesTheBlocker) {
  push(hall_, 10);
  EXPECT_THAT(handle_ready(), IsEmpty());
  EXPECT_EQ(order_.blocker(), "coils");
  push(coils_, 12);
  EXPECT_THAT(handle_ready(), ElementsAre(std::pair(hall_, 10)));
  EXPECT_EQ(order_.blocker(), "hall");
}

TEST_F(EventOrderTest, OrdersByUtimeWhateverTheArrival) {
  push(hall_, 30);
  push(coils_, 20);
  push(coils_, 40);
  push(hall_, 50);
  EXPECT_THAT(handle_ready(),
              ElementsAre(std::pair(coils_, 20), std::pair(hall_, 30), std::pair(coils_, 40)));
}

TEST_F(EventOrderTest, EqualUtimesComeInTheOrderOfTheInputs) {
  push(hall_, 10);
  push(coils_, 10);
  EXPECT_THAT(handle_ready(), ElementsAre(std::pair(coils_, 10), std::pair(hall_, 10)));
}

TEST_F(EventOrderTest, ReorderedMessagesOfOneInputAreSortedBeforeTheirTurn) {
  push(hall_, 20);
  push(hall_, 10);
  push(coils_, 30);
  EXPECT_THAT(handle_ready(), ElementsAre(std::pair(hall_, 10), std::pair(hall_, 20)));
}

TEST_F(EventOrderTest, SilentInputIsNoLongerWaitedForUntilItIsBack) {
  push(hall_, 0);
  push(hall_, kLag);
  EXPECT_THAT(handle_ready(), IsEmpty());
  push(hall_, kLag + 1);
  EXPECT_THAT(order_.silent_inputs(), ElementsAre("coils"));
  EXPECT_EQ(handle_ready().size(), 3U);
  push(coils_, kLag + 2);
  EXPECT_THAT(order_.silent_inputs(), IsEmpty());
  push(hall_, kLag + 10);
  EXPECT_THAT(handle_ready(), ElementsAre(std::pair(coils_, kLag + 2)));
  EXPECT_EQ(order_.blocker(), "coils");
}

TEST_F(EventOrderTest, WhatComesAfterItsTurnIsLate) {
  push(hall_, 10);
  push(coils_, 10);
  handle_ready();
  EXPECT_EQ(push(hall_, 9), PushResult::kLate);
  EXPECT_EQ(push(hall_, 10), PushResult::kLate);
  EXPECT_EQ(push(coils_, 10), PushResult::kLate);
  EXPECT_EQ(push(hall_, 11), PushResult::kQueued);
}

TEST_F(EventOrderTest, RepeatedUtimeOfOneInputIsLate) {
  EXPECT_EQ(push(hall_, 10), PushResult::kQueued);
  EXPECT_EQ(push(hall_, 10), PushResult::kLate);
}

TEST_F(EventOrderTest, OneMessageFromTheFarFutureDoesNotSilenceTheOthers) {
  constexpr std::int64_t kYear = 31'557'600'000'000;
  push(hall_, 10);
  push(coils_, 10);
  EXPECT_EQ(push(hall_, kYear), PushResult::kImplausible);
  EXPECT_EQ(push(hall_, 20), PushResult::kQueued);
  EXPECT_THAT(order_.silent_inputs(), IsEmpty());
}

TEST_F(EventOrderTest, AJumpThatTheNextMessageConfirmsIsBelieved) {
  constexpr std::int64_t kHour = 3'600'000'000;
  push(hall_, 10);
  EXPECT_EQ(push(hall_, kHour), PushResult::kImplausible);
  EXPECT_EQ(push(hall_, kHour + 1), PushResult::kQueued);
}

TEST_F(EventOrderTest, DrainHandsOutTheRestInOrder) {
  push(hall_, 30);
  push(coils_, 10);
  push(hall_, 20);
  EXPECT_THAT(handle_all(),
              ElementsAre(std::pair(coils_, 10), std::pair(hall_, 20), std::pair(hall_, 30)));
  EXPECT_EQ(order_.pending(), 0U);
}

TEST_F(EventOrderTest, KeepNewestDropsOnlyEventsWhoseTurnHasCome) {
  for (std::int64_t utime = 1; utime <= 5; ++utime) push(hall_, utime);
  push(coils_, 3);
  EXPECT_EQ(order_.keep_newest(hall_), 2U);
  EXPECT_THAT(handle_ready(), ElementsAre(std::pair(coils_, 3), std::pair(hall_, 3)));
  EXPECT_EQ(order_.pending(), 2U);
}

}  // namespace
}  // namespace gastronaut

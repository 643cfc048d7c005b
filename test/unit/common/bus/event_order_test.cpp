#include "bus/event_order.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

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

// A live input whose messages are all a little late: as one that is started after the others, and
// takes its time.
TEST_F(EventOrderTest, SilentInputThatComesBackLateIsWaitedForAgain) {
  push(hall_, 0);
  push(hall_, 2 * kLag);
  handle_ready();
  EXPECT_EQ(push(coils_, 2 * kLag - 10), PushResult::kLate);
  EXPECT_THAT(order_.silent_inputs(), IsEmpty());
  push(hall_, 2 * kLag + 20);
  EXPECT_THAT(handle_ready(), IsEmpty());
  EXPECT_EQ(push(coils_, 2 * kLag + 10), PushResult::kQueued);
  EXPECT_THAT(handle_ready(), ElementsAre(std::pair(coils_, 2 * kLag + 10)));
}

// One input, and the answers to what is made of it.
class FeedbackTest : public EventOrderTest {
 protected:
  FeedbackTest() : depth(0), state(1) {
    order_ = EventOrder();
    order_.add_input("depth", kLag);
    order_.add_feedback("state", kLag);
  }
  void see(std::int64_t utime) {
    push(depth, utime);
    EXPECT_THAT(handle_ready(), ElementsAre(std::pair(depth, utime)));
  }

  const int depth;
  const int state;
};

TEST_F(FeedbackTest, NothingIsHandedOutBeforeTheAnswer) {
  see(10);
  EXPECT_TRUE(order_.await(state, 10));
  push(depth, 20);
  push(state, 9);
  EXPECT_THAT(handle_ready(), IsEmpty());
  EXPECT_EQ(order_.blocker(), "state");
  EXPECT_EQ(push(state, 10), PushResult::kQueued);
  EXPECT_EQ(order_.blocker(), "");
  EXPECT_EQ(order_.pending(), 2U);
  EXPECT_THAT(handle_ready(), ElementsAre(std::pair(state, 10), std::pair(depth, 20)));
}

TEST_F(FeedbackTest, NewerMessageTellsThatTheAnswerWillNotCome) {
  see(10);
  order_.await(state, 10);
  push(depth, 20);
  push(state, 11);
  EXPECT_THAT(handle_ready(), ElementsAre(std::pair(depth, 20)));
  EXPECT_FALSE(order_.await(state, 5));
}

TEST_F(FeedbackTest, WhatNobodyAwaitsIsDroppedAndWaitedForByNobody) {
  push(depth, 10);
  for (const std::int64_t utime : {8, 9, 10, 11, 12}) {
    EXPECT_EQ(push(state, utime), PushResult::kQueued);
  }
  EXPECT_EQ(order_.pending(), 1U);
  EXPECT_THAT(handle_ready(), ElementsAre(std::pair(depth, 10)));
  push(depth, 20 + 10 * kLag);
  EXPECT_EQ(handle_ready().size(), 1U);
}

TEST_F(FeedbackTest, SilentFeedbackIsNoLongerAwaitedUntilItIsBack) {
  see(10);
  order_.await(state, 10);
  push(depth, 10 + kLag);
  EXPECT_THAT(handle_ready(), IsEmpty());
  EXPECT_THAT(order_.silent_inputs(), IsEmpty());
  push(depth, 11 + kLag);
  EXPECT_THAT(order_.silent_inputs(), ElementsAre("state"));
  EXPECT_THAT(handle_ready(),
              ElementsAre(std::pair(depth, 10 + kLag), std::pair(depth, 11 + kLag)));
  EXPECT_FALSE(order_.await(state, 11 + kLag));
  see(20 + kLag);
  push(state, 11 + kLag);
  EXPECT_THAT(order_.silent_inputs(), IsEmpty());
  EXPECT_TRUE(order_.await(state, 20 + kLag));
}

// However far apart the events are.
TEST_F(FeedbackTest, AnswerOfARareEventIsWaitedFor) {
  for (std::int64_t utime = 0; utime < 50 * kLag; utime += 10 * kLag) {
    see(utime);
    EXPECT_TRUE(order_.await(state, utime));
    push(state, utime);
    EXPECT_THAT(handle_ready(), ElementsAre(std::pair(state, utime)));
  }
}

TEST_F(FeedbackTest, CorruptUtimesAreForgottenWithTheNextMessage) {
  constexpr std::int64_t kSecond = 1'000'000;
  std::int64_t utime = 10;
  for (const std::int64_t corrupt :
       {std::numeric_limits<std::int64_t>::max(), std::numeric_limits<std::int64_t>::min(),
        std::int64_t{50 * kSecond}, std::int64_t{-50 * kSecond}}) {
    SCOPED_TRACE(corrupt);
    see(utime);
    order_.await(state, utime);
    push(state, corrupt);
    handle_ready();
    push(state, utime + 1);
    see(utime += 10);
    EXPECT_TRUE(order_.await(state, utime));
    push(state, utime);
    EXPECT_THAT(handle_ready(), ElementsAre(std::pair(state, utime)));
    utime += 10;
  }
  EXPECT_EQ(push(state, 1000 * kSecond), PushResult::kImplausible);
  EXPECT_EQ(push(state, 1000 * kSecond), PushResult::kImplausible);
}

TEST_F(FeedbackTest, DrainUsesAnAnswerThatIsThereAndElseGoesOn) {
  see(10);
  order_.await(state, 10);
  push(state, 10);
  push(depth, 20);
  EXPECT_THAT(handle_all(), ElementsAre(std::pair(state, 10), std::pair(depth, 20)));
  order_.await(state, 20);
  push(depth, 30);
  EXPECT_THAT(handle_all(), ElementsAre(std::pair(depth, 30)));
  push(state, 20);  // too late
  EXPECT_THAT(handle_all(), IsEmpty());
}

TEST_F(FeedbackTest, NothingIsSkippedWhileAnAnswerIsAwaited) {
  see(10);
  order_.await(state, 10);
  push(depth, 20);
  push(depth, 30);
  EXPECT_EQ(order_.keep_newest(depth), 0U);
  push(state, 10);
  handled_.clear();
  order_.pop()->handle();
  EXPECT_THAT(handled_, ElementsAre(std::pair(state, 10)));
  EXPECT_EQ(order_.keep_newest(depth), 1U);
}

}  // namespace
}  // namespace gastronaut

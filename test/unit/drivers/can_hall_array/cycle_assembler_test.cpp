#include "can_hall_array/cycle_assembler.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace gastronaut {
namespace {

using ::testing::ElementsAre;

constexpr std::int64_t kPeriod = 5000;  // microseconds: 200 readings a second
constexpr std::int64_t kFrameGap = 300;
constexpr int kParts = 3;

CycleAssembler::Settings settings(int counter_bits = 16) {
  CycleAssembler::Settings wanted;
  wanted.num_parts = kParts;
  wanted.num_values = kParts;  // a value a part
  wanted.counter_bits = counter_bits;
  wanted.rate = 200;
  wanted.timeout = 0.02;
  return wanted;
}

class CycleAssemblerTest : public ::testing::Test {
 protected:
  explicit CycleAssemblerTest(int counter_bits = 16)
      : assembler_(settings(counter_bits), [this](const CycleAssembler::Reading& reading) {
          readings_.push_back(reading);
        }) {}

  // Reading `number` is taken at number * kPeriod and carries part + 10 * number.
  void add(int part, std::int64_t number, std::int64_t delay = 0) {
    const std::vector<std::pair<std::size_t, double>> values = {
        {static_cast<std::size_t>(part), part + 10.0 * static_cast<double>(number)}};
    assembler_.add(part, static_cast<std::uint64_t>(number),
                   number * kPeriod + part * kFrameGap + delay, values);
  }
  void add_all(std::int64_t number) {
    for (int part = 0; part < kParts; ++part) add(part, number);
  }
  std::vector<std::int64_t> numbers() const {
    std::vector<std::int64_t> numbers;
    for (const auto& reading : readings_) numbers.push_back(reading.number);
    return numbers;
  }

  CycleAssembler assembler_;
  std::vector<CycleAssembler::Reading> readings_;
};

TEST_F(CycleAssemblerTest, AReadingComesOutWithItsLastFrameAndTheTimeOfItsFirst) {
  add(0, 7);
  add(1, 7);
  EXPECT_TRUE(readings_.empty());
  add(2, 7);
  ASSERT_EQ(readings_.size(), 1U);
  EXPECT_EQ(readings_[0].number, 7);
  EXPECT_EQ(readings_[0].utime, 7 * kPeriod);
  EXPECT_TRUE(readings_[0].complete);
  EXPECT_THAT(readings_[0].values, ElementsAre(70, 71, 72));
}

TEST_F(CycleAssemblerTest, WhatDidNotComeIsMissingAndNotTheLastReadings) {
  add_all(1);
  add(0, 2);
  add(2, 2);
  add_all(3);
  EXPECT_THAT(numbers(), ElementsAre(1)) << "a frame may be overtaken by those of the next reading";
  add(0, 4);
  ASSERT_THAT(numbers(), ElementsAre(1, 2, 3));
  EXPECT_FALSE(readings_[1].complete);
  EXPECT_EQ(readings_[1].values[0], 20);
  EXPECT_TRUE(std::isnan(readings_[1].values[1]));
  EXPECT_EQ(readings_[1].values[2], 22);
  EXPECT_EQ(assembler_.counters().incomplete, 1);
}

TEST_F(CycleAssemblerTest, AReadingThatNeverBecomesWholeComesOutAfterTheTimeout) {
  add(0, 1);
  assembler_.advance(kPeriod + 20'000);
  EXPECT_TRUE(readings_.empty());
  assembler_.advance(kPeriod + 20'001);
  ASSERT_EQ(readings_.size(), 1U);
  EXPECT_FALSE(readings_[0].complete);
  add(1, 1, 21'000);
  EXPECT_EQ(readings_.size(), 1U) << "handed out once";
  EXPECT_EQ(assembler_.counters().late, 1);
}

TEST_F(CycleAssemblerTest, FramesInAnyOrderWithinTwoReadingsMakeTheSameReadings) {
  std::mt19937 random(1);
  for (std::int64_t number = 0; number < 100; number += 2) {
    std::vector<std::pair<int, std::int64_t>> frames;
    for (int part = 0; part < kParts; ++part) {
      frames.emplace_back(part, number);
      frames.emplace_back(part, number + 1);
    }
    std::shuffle(frames.begin(), frames.end(), random);
    // The earlier reading must not be due before its last frame.
    for (const auto& [part, of] : frames) add(part, of);
  }
  assembler_.finish();
  const CycleAssembler::Counters& counters = assembler_.counters();
  // A later reading may be whole before the earlier one has begun; then the earlier one is late.
  EXPECT_EQ(counters.complete + counters.incomplete + counters.lost, 100);
  EXPECT_EQ(counters.incomplete, 0);
  EXPECT_EQ(counters.late, counters.lost * kParts);
  for (const CycleAssembler::Reading& reading : readings_) {
    const auto base = 10.0 * static_cast<double>(reading.number);
    EXPECT_THAT(reading.values, ElementsAre(base, base + 1, base + 2));
    EXPECT_EQ(reading.utime, reading.number * kPeriod);
  }
}

TEST_F(CycleAssemblerTest, FramesThatComeTwiceCountOnce) {
  add(0, 1);
  add(0, 1, 10);
  add(1, 1);
  EXPECT_TRUE(readings_.empty());
  add(2, 1);
  add(2, 1, 10);
  ASSERT_EQ(readings_.size(), 1U);
  EXPECT_EQ(assembler_.counters().duplicates, 1);
  EXPECT_EQ(assembler_.counters().late, 1) << "the second one came after the reading was out";
}

TEST_F(CycleAssemblerTest, ReadingsOfWhichNothingCameAreCounted) {
  add_all(1);
  add_all(5);
  EXPECT_THAT(numbers(), ElementsAre(1, 5));
  EXPECT_EQ(assembler_.counters().lost, 3);
}

TEST_F(CycleAssemblerTest, TheArrayMayBeginToCountAnewAtAnyNumber) {
  for (const std::uint64_t before : {100, 40'000, 65'000}) {
    SCOPED_TRACE(before);
    readings_.clear();
    CycleAssembler assembler(settings(), [this](const CycleAssembler::Reading& reading) {
      readings_.push_back(reading);
    });
    const auto add_reading = [&](std::uint64_t counter, std::int64_t utime) {
      for (int part = 0; part < kParts; ++part) assembler.add(part, counter, utime, {});
    };
    add_reading(before, 0);
    add_reading(0, 100 * kPeriod);
    add_reading(1, 101 * kPeriod);
    EXPECT_EQ(assembler.counters().restarts, 1);
    const auto first = static_cast<std::int64_t>(before);
    // Numbers go on by the clock: 99 readings are lost.
    EXPECT_THAT(numbers(), ElementsAre(first, first + 100, first + 101));
    EXPECT_EQ(assembler.counters().lost, 99);
  }
}

class NarrowCounterTest : public CycleAssemblerTest {
 protected:
  NarrowCounterTest() : CycleAssemblerTest(4) {}  // wraps at 16
};

TEST_F(NarrowCounterTest, NumbersGoOnWhereTheCounterWraps) {
  for (std::int64_t number = 0; number < 100; ++number) add_all(number);
  ASSERT_EQ(readings_.size(), 100U);
  EXPECT_EQ(readings_.back().number, 99);
  EXPECT_EQ(assembler_.counters().lost, 0);
  EXPECT_EQ(assembler_.counters().restarts, 0);
}

TEST_F(NarrowCounterTest, ASilenceOfManyTurnsOfTheCounterIsBridgedByTheClock) {
  add_all(3);
  for (const std::int64_t number : {3 + 14, 17 + 16 * 50 + 5, 1000}) add_all(number);
  EXPECT_THAT(numbers(), ElementsAre(3, 17, 822, 1000));
  EXPECT_EQ(assembler_.counters().lost, 1000 - 3 - 3);
}

TEST_F(CycleAssemblerTest, ClocksThatAreSetDoNotStopTheReadings) {
  add_all(1);
  for (const std::int64_t hours : {5, -5}) {
    const std::int64_t step = hours * 3'600'000'000;
    const auto before = readings_.size();
    for (std::int64_t number = 0; number < 10; ++number) {
      for (int part = 0; part < kParts; ++part) {
        assembler_.add(part, static_cast<std::uint64_t>(number + 2), step + number * kPeriod, {});
      }
    }
    EXPECT_GE(readings_.size(), before + 5) << hours;
  }
  for (std::size_t i = 1; i < readings_.size(); ++i) {
    EXPECT_GT(readings_[i].number, readings_[i - 1].number);
  }
}

}  // namespace
}  // namespace gastronaut

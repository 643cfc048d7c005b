#include "evaluate/sensor_failures.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <limits>
#include <stdexcept>
#include <variant>

namespace gastronaut::evaluation {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr std::int64_t kZero = 1700000000000000;  // microseconds
constexpr double kStep = 0.1;                     // seconds between states
constexpr int kStates = 400;
constexpr double kThreshold = 0.5;
constexpr double kRounding = 1e-9;  // of sums of a few hundred numbers of order one

std::int64_t utime_of(int state) { return kZero + state * 100000; }

// A sensor that is held for failed in the given numbers of states, first to last.
std::vector<SensorHealth> failed_in(const std::vector<std::pair<int, int>>& spans) {
  std::vector<SensorHealth> health;
  for (int i = 0; i < kStates; ++i) {
    SensorHealth sample;
    sample.utime = utime_of(i);
    for (const auto& [first, last] : spans) {
      if (i >= first && i <= last) sample.p_nominal = 0.1;
    }
    health.push_back(sample);
  }
  return health;
}

SensorVerdict judge(const std::vector<SensorHealth>& health,
                    const std::vector<TrueFailure>& failures) {
  return judge_sensor("visual", health, failures, kZero, kThreshold);
}

TEST(ParseFailureTest, ReadsSensorAndSeconds) {
  const TrueFailure failure = parse_failure("magnetic:18.5-23");
  EXPECT_EQ(failure.sensor, "magnetic");
  EXPECT_EQ(failure.start, 18.5);
  EXPECT_EQ(failure.end, 23);
}

TEST(ParseFailureTest, RefusesWhatIsNoSpanOfTime) {
  for (const char* text :
       {"", "visual", "visual:", "visual:7", "visual:7-", "visual:13-7", "visual:7-7", ":7-13",
        "visual:7-13s", "visual:-1-13", "visual:7-inf", "visual:nan-3", "visual 7-13"}) {
    EXPECT_THROW(parse_failure(text), std::invalid_argument) << text;
  }
}

TEST(JudgeSensorTest, DelaysCountFromTheTrueStartAndEnd) {
  // States 103 (10.3 s) to 203 (20.3 s): nominal again at 20.4 s.
  const SensorVerdict verdict = judge(failed_in({{103, 203}}), {{"visual", 10, 20}});
  ASSERT_EQ(verdict.notices.size(), 1U);
  EXPECT_NEAR(verdict.notices[0].detection_delay.value(), 0.3, kRounding);
  EXPECT_NEAR(verdict.notices[0].recovery_delay.value(), 0.4, kRounding);
  EXPECT_NEAR(verdict.notices[0].missed_share, 0.3 / 10, kRounding);
  EXPECT_EQ(verdict.false_alarms, 0U);
}

TEST(JudgeSensorTest, BelievingAFailedSensorInBetweenIsMissedTime) {
  // 10.0 to 12.0 s and 15.0 to 20.0 s of a failure from 10 to 20 s.
  const SensorVerdict verdict = judge(failed_in({{100, 119}, {150, 205}}), {{"visual", 10, 20}});
  EXPECT_NEAR(verdict.notices[0].detection_delay.value(), 0, kRounding);
  EXPECT_NEAR(verdict.notices[0].missed_share, 0.3, kRounding);
  EXPECT_EQ(verdict.false_alarms, 0U);
}

TEST(JudgeSensorTest, ARelapseDelaysTheRecovery) {
  // Believed from 20.4 to 20.6 s, then not before 23.0 s.
  const SensorVerdict verdict = judge(failed_in({{103, 203}, {206, 229}}), {{"visual", 10, 20}});
  EXPECT_NEAR(verdict.notices[0].recovery_delay.value(), 3, kRounding);
  EXPECT_EQ(verdict.false_alarms, 0U);
}

TEST(JudgeSensorTest, ASensorStillOutAtTheLogsEndDidNotRecover) {
  const SensorVerdict verdict = judge(failed_in({{103, kStates - 1}}), {{"visual", 10, 20}});
  EXPECT_FALSE(verdict.notices[0].recovery_delay);
  EXPECT_NEAR(verdict.notices[0].detection_delay.value(), 0.3, kRounding);
}

TEST(JudgeSensorTest, AnUnnoticedFailureHasNoDelay) {
  const SensorVerdict verdict = judge(failed_in({}), {{"visual", 10, 20}});
  EXPECT_FALSE(verdict.notices[0].detection_delay);
  EXPECT_FALSE(verdict.notices[0].recovery_delay);
  EXPECT_EQ(verdict.notices[0].missed_share, 1);
}

TEST(JudgeSensorTest, ASensorStillOutAtTheNextFailureDidNotRecover) {
  const SensorVerdict verdict =
      judge(failed_in({{100, 260}}), {{"visual", 22, 25}, {"visual", 10, 20}});
  ASSERT_EQ(verdict.notices.size(), 2U);
  EXPECT_EQ(verdict.notices[0].failure.start, 10);
  EXPECT_FALSE(verdict.notices[0].recovery_delay);
  EXPECT_NEAR(verdict.notices[1].recovery_delay.value(), 1.1, kRounding);
  EXPECT_NEAR(verdict.notices[1].detection_delay.value(), 0, kRounding);
}

TEST(JudgeSensorTest, CountsAlarmsThatTouchNoFailureOfThatSensor) {
  // At 5 s for 0.5 s; while only the magnet has failed; 0.5 s after the failure's end, which its
  // recovery excuses; 2 s after it, for 1 s.
  const SensorVerdict verdict = judge(failed_in({{50, 54}, {80, 81}, {205, 206}, {220, 229}}),
                                      {{"visual", 10, 20}, {"magnetic", 7, 9}});
  EXPECT_EQ(verdict.false_alarms, 3U);
  EXPECT_NEAR(verdict.false_alarm_seconds, 0.5 + 0.2 + 1, kRounding);
}

TEST(JudgeSensorTest, AnAlarmFromLongBeforeIsFalseAndDetectsNothing) {
  // From 5.0 s on, 5 s before the failure, to 12.0 s in it.
  const SensorVerdict verdict = judge(failed_in({{50, 119}}), {{"visual", 10, 20}});
  EXPECT_FALSE(verdict.notices[0].detection_delay);
  EXPECT_EQ(verdict.false_alarms, 1U);
  EXPECT_NEAR(verdict.false_alarm_seconds, 5, kRounding);
  // The sensor was not believed all the same.
  EXPECT_NEAR(verdict.notices[0].missed_share, 0.8, kRounding);
}

TEST(JudgeSensorTest, AnAlarmFromALittleBeforeIsOfTheFailure) {
  const SensorVerdict verdict = judge(failed_in({{86, 203}}), {{"visual", 10, 20}});
  EXPECT_NEAR(verdict.notices[0].detection_delay.value(), 0, kRounding);
  EXPECT_EQ(verdict.false_alarms, 0U);
}

TEST(JudgeSensorTest, WhatComesAfterAFalseAlarmIsStillADetection) {
  // Out from 5 to 11 s without cause, believed, and out again at 13.0 s.
  const SensorVerdict verdict = judge(failed_in({{50, 109}, {130, 203}}), {{"visual", 10, 20}});
  EXPECT_NEAR(verdict.notices[0].detection_delay.value(), 3, kRounding);
  EXPECT_EQ(verdict.false_alarms, 1U);
}

TEST(JudgeSensorTest, NotANumberIsNoHealth) {
  std::vector<SensorHealth> health = failed_in({});
  health[50].p_nominal = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(judge(health, {}).false_alarms, 1U);
}

enum Status : std::int8_t { kInitialising, kNominal };

// The capsule goes 1 mm a state along x; the fused position is off by `error` metres along y.
class FailureMetricsTest : public testing::Test {
 protected:
  std::vector<std::string> score(const std::function<double(int)>& error,
                                 const SensorHealthSeries& health,
                                 const std::vector<TrueFailure>& failures) {
    PoseChannel state;
    state.statuses = {{"INITIALISING", false}, {"NOMINAL", true}};
    TruthTrack truth;
    for (int i = 0; i < kStates; ++i) {
      const Eigen::Vector3d place(1e-3 * i, 0, 0);
      truth.add(utime_of(i), {Eigen::Quaterniond::Identity(), place});
      PoseFix fix;
      fix.utime = utime_of(i);
      fix.status = i < kFirstNominal ? kInitialising : kNominal;
      fix.pose.translation = place + Eigen::Vector3d(0, i < kFirstNominal ? 1 : error(i), 0);
      state.fixes.push_back(fix);
    }
    return set_failure_metrics(metrics_, health, state, evaluate_pose_channel(state, truth, SE3{}),
                               failures, kZero, kThreshold);
  }

  double metric(const std::string& key) const {
    for (const auto& [name, value] : metrics_.list()) {
      if (name != key) continue;
      if (const double* number = std::get_if<double>(&value)) return *number;
      return static_cast<double>(std::get<std::int64_t>(value));
    }
    ADD_FAILURE() << "no " << key;
    return std::nan("");
  }
  bool has(const std::string& key) const {
    for (const auto& [name, value] : metrics_.list()) {
      if (name == key) return true;
    }
    return false;
  }

  static constexpr int kFirstNominal = 5;
  Metrics metrics_;
};

TEST_F(FailureMetricsTest, ErrorsInsideAreComparedWithThoseOutside) {
  // 1 mm, from the 10th to the 30th second 2 mm, or 4 mm from the 25th on; 9 mm for the second
  // after it, in which the sensor may recover and nothing counts.
  const auto error = [](int i) {
    if (i >= 100 && i <= 300) return i < 250 ? 2e-3 : 4e-3;
    return i > 300 && i <= 310 ? 9e-3 : 1e-3;
  };
  score(error, {{"visual", failed_in({{100, 300}})}}, {{"visual", 10, 30}});
  EXPECT_NEAR(metric("failure.nominal.error.rmse"), 1e-3, kRounding);
  EXPECT_NEAR(metric("failure.visual.1.error.max"), 4e-3, kRounding);
  const double rmse = std::sqrt((150 * 4e-6 + 51 * 16e-6) / 201);
  EXPECT_NEAR(metric("failure.visual.1.error.rmse"), rmse, kRounding);
  EXPECT_NEAR(metric("failure.visual.1.ratio_to_nominal"), rmse / 1e-3, kRounding);
  // Of 151 states in the first 15 s, the last has 4 mm.
  const double early = std::sqrt((150 * 4e-6 + 16e-6) / 151) / 1e-3;
  EXPECT_NEAR(metric("failure.visual.1.ratio_to_nominal_15s"), early, kRounding);
  EXPECT_NEAR(metric("failure.worst.ratio_to_nominal_15s"), early, kRounding);
  EXPECT_EQ(metric("failure.undetected"), 0);
  EXPECT_EQ(metric("failure.false_alarms"), 0);
}

TEST_F(FailureMetricsTest, NominalIsTheErrorWhileEverySensorIsBelieved) {
  // Not back before 25 s, 5 s late, and out again without cause from 30 to 32 s.
  const auto error = [](int i) {
    return (i >= 100 && i <= 260) || (i >= 300 && i <= 330) ? 7e-3 : 1e-3;
  };
  score(error, {{"visual", failed_in({{100, 249}, {300, 319}})}}, {{"visual", 10, 20}});
  EXPECT_NEAR(metric("failure.nominal.error.rmse"), 1e-3, kRounding);
  EXPECT_NEAR(metric("failure.worst.recovery_delay"), 5, kRounding);
}

TEST_F(FailureMetricsTest, TheJumpIsTheLargestStepAroundTheSensorsReturn) {
  // Back at 20.4 s, where the error of 5 mm goes away at once. A larger step in the failure and
  // another long after it are none of its return.
  const auto error = [](int i) {
    if (i == 150) return 20e-3;
    if (i == 230) return 50e-3;
    return i >= 100 && i < 204 ? 5e-3 : 0;
  };
  score(error, {{"visual", failed_in({{100, 203}})}}, {{"visual", 10, 20}});
  EXPECT_NEAR(metric("failure.visual.1.jump"), std::hypot(5e-3, 1e-3), kRounding);
  EXPECT_NEAR(metric("failure.visual.1.jump_of_truth"), 1e-3, kRounding);
}

TEST_F(FailureMetricsTest, WithoutAnySensorNothingIsPromised) {
  const auto error = [](int i) { return i >= 200 && i <= 220 ? 30e-3 : 1e-3; };
  score(error,
        {{"magnetic", failed_in({{200, 220}})}, {"visual", failed_in({{100, 120}, {200, 221}})}},
        {{"visual", 10, 12}, {"visual", 20, 22}, {"magnetic", 20, 22}});
  EXPECT_NEAR(metric("failure.visual.2.ratio_to_nominal"), 30, kRounding);
  EXPECT_NEAR(metric("failure.magnetic.1.ratio_to_nominal"), 30, kRounding);
  EXPECT_NEAR(metric("failure.worst.ratio_to_nominal_15s"), 1, kRounding);
  EXPECT_NEAR(metric("failure.worst.recovery_delay"), 0.2, kRounding);
}

TEST_F(FailureMetricsTest, AFailureCountsForAsLongAsItIsTheOnlyOne) {
  // The magnet fails too from 28 s on: after the first 15 s of vision's failure.
  const auto error = [](int i) { return i >= 280 && i <= 300 ? 30e-3 : 1e-3; };
  score(error, {{"magnetic", failed_in({{280, 300}})}, {"visual", failed_in({{100, 300}})}},
        {{"visual", 10, 30}, {"magnetic", 28, 30}});
  EXPECT_NEAR(metric("failure.worst.ratio_to_nominal_15s"), 1, kRounding);
}

TEST_F(FailureMetricsTest, CountsFailuresWithoutARecovery) {
  score([](int) { return 1e-3; }, {{"visual", failed_in({{100, 110}, {203, kStates - 1}})}},
        {{"visual", 10, 11}, {"visual", 15, 16}, {"visual", 20, 22}});
  EXPECT_EQ(metric("failure.undetected"), 1);
  EXPECT_EQ(metric("failure.unrecovered"), 1);
  EXPECT_NEAR(metric("failure.worst.recovery_delay"), 0.1, kRounding);
}

TEST_F(FailureMetricsTest, WithoutTrueFailuresEveryAlarmIsFalseAndSaidToBe) {
  const auto notes = score([](int) { return 1e-3; }, {{"visual", failed_in({{100, 109}})}}, {});
  EXPECT_EQ(metric("failure.visual.false_alarms.count"), 1);
  EXPECT_NEAR(metric("failure.visual.false_alarms.seconds"), 1, kRounding);
  EXPECT_FALSE(has("failure.undetected"));
  EXPECT_THAT(notes, ElementsAre(HasSubstr("no --failure was given")));
  EXPECT_THAT(score([](int) { return 1e-3; }, {{"visual", failed_in({})}}, {}), ElementsAre());
}

TEST_F(FailureMetricsTest, NamesASensorThatTheFusionDoesNotKnow) {
  const auto notes =
      score([](int) { return 1e-3; }, {{"visual", failed_in({})}}, {{"sonar", 1, 2}});
  EXPECT_THAT(notes, ElementsAre(testing::AllOf(HasSubstr("sonar"), HasSubstr("visual"))));
}

}  // namespace
}  // namespace gastronaut::evaluation

// How soon and how surely the fusion notices that a sensor has failed, and how well it carries on
// meanwhile: the paper's failure experiment in figures.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "evaluate/metrics.hpp"
#include "evaluate/pose_channel.hpp"

namespace gastronaut::evaluation {

// What one CAPSULE_STATE says of one sensor.
struct SensorHealth {
  std::int64_t utime = 0;  // microseconds
  double p_nominal = 1;    // 0..1, posterior of the switch
  double alpha = 1;        // 0..1, confidence
  bool used = true;
  std::string cause;  // empty: nominal
};
// By the sensor's name, each with ascending utimes; without the time before the first state.
using SensorHealthSeries = std::map<std::string, std::vector<SensorHealth>>;

// From `start` to `end` the sensor was of no use. Seconds from the first pose, true pose or
// compared depth, as on the time axes of the report.
struct TrueFailure {
  std::string sensor;
  double start = 0;
  double end = 0;
};
// "visual:7-13". Throws std::invalid_argument that says what is possible.
TrueFailure parse_failure(const std::string& text);

// A sensor counts as failed while its p_nominal is below the threshold. After a failure's end it
// has this long to recover before that counts as a false alarm.
inline constexpr double kRecoveryTime = 1;  // seconds

// An alarm that begins more than the target for the delay and a second before a failure is not of
// that failure.
inline constexpr double kForewarning = 1.5;  // seconds

struct FailureNotice {
  TrueFailure failure;
  // Seconds from its start; nothing: not noticed. 0 for an alarm that was there before: a little
  // before, or since an earlier failure.
  std::optional<double> detection_delay;
  // From its end until the sensor counts as nominal and stays so; nothing: not before the next
  // failure, or never noticed.
  std::optional<double> recovery_delay;
  double missed_share = 1;  // of its time in which the sensor counted as nominal, 0..1
};
struct SensorVerdict {
  std::vector<FailureNotice> notices;  // by start
  std::size_t false_alarms = 0;        // times below the threshold that are of no failure
  double false_alarm_seconds = 0;      // without what of them reaches into a failure
};
// `failures`: all of them, of which those of `sensor` are looked at. `zero`: the utime they count
// from.
SensorVerdict judge_sensor(const std::string& sensor, const std::vector<SensorHealth>& health,
                           const std::vector<TrueFailure>& failures, std::int64_t zero,
                           double threshold);

// failure.SENSOR.NUMBER.* (numbers from 1, by start), failure.SENSOR.false_alarms.*, and over all
// of them failure.nominal.*, failure.undetected, failure.unrecovered (noticed, but without a
// recovery), failure.false_alarms and failure.worst.*, of which the ratio is over failures in whose
// first 15 s no other sensor has failed. Nominal is the time more than kRecoveryTime after any
// failure or alarm. `state` and `evaluation` are those of CAPSULE_STATE; a state counts unless it
// is INITIALISING. Returns what one should know of the figures.
std::vector<std::string> set_failure_metrics(Metrics& metrics, const SensorHealthSeries& health,
                                             const PoseChannel& state,
                                             const PoseEvaluation& evaluation,
                                             const std::vector<TrueFailure>& failures,
                                             std::int64_t zero, double threshold);

}  // namespace gastronaut::evaluation

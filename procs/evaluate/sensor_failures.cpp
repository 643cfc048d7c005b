#include "evaluate/sensor_failures.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <stdexcept>
#include <string_view>

namespace gastronaut::evaluation {
namespace {

// For so long the error in a failure is to stay near the nominal one (the project's target).
constexpr double kCarriesOn = 15;  // seconds
// So long before and after a sensor is back the state must not jump.
constexpr double kJumpTime = 1;  // seconds

double seconds(std::int64_t utime, std::int64_t zero) {
  return static_cast<double>(utime - zero) * 1e-6;
}

std::vector<TrueFailure> failures_of(const std::string& sensor,
                                     const std::vector<TrueFailure>& failures) {
  std::vector<TrueFailure> own;
  for (const TrueFailure& failure : failures) {
    if (failure.sensor == sensor) own.push_back(failure);
  }
  std::stable_sort(own.begin(), own.end(),
                   [](const auto& a, const auto& b) { return a.start < b.start; });
  return own;
}

struct Span {
  double begin;  // seconds
  double end;
  bool over = true;  // nominal from `end` on; else the log ends there
};

// From the first sample below the threshold to the next one that is not, or the last of all.
std::vector<Span> alarms(const std::vector<SensorHealth>& health, std::int64_t zero,
                         double threshold) {
  std::vector<Span> result;
  bool failed = false;
  for (const SensorHealth& sample : health) {
    const double time = seconds(sample.utime, zero);
    const bool fails = !(sample.p_nominal >= threshold);  // not-a-number is no health
    if (fails && !failed) result.push_back({time, time});
    if (fails || failed) {
      result.back().end = time;
      result.back().over = !fails;
    }
    failed = fails;
  }
  return result;
}

// When any sensor has failed or is held for failed.
std::vector<Span> troubles(const SensorHealthSeries& health,
                           const std::vector<TrueFailure>& failures, std::int64_t zero,
                           double threshold) {
  std::vector<Span> result;
  for (const TrueFailure& failure : failures) result.push_back({failure.start, failure.end});
  for (const auto& [name, series] : health) {
    const std::vector<Span> found = alarms(series, zero, threshold);
    result.insert(result.end(), found.begin(), found.end());
  }
  return result;
}

// An alarm in the time to recover is part of the failure: a sensor that is believed for a moment
// and then not has not recovered.
bool touches(const Span& alarm, const TrueFailure& failure) {
  return alarm.end >= failure.start && alarm.begin <= failure.end + kRecoveryTime;
}

// One that was there long before has another cause, or none.
bool is_alarm_of_any(const Span& alarm, const std::vector<TrueFailure>& failures) {
  return std::any_of(failures.begin(), failures.end(), [&](const TrueFailure& failure) {
    return touches(alarm, failure) && alarm.begin >= failure.start - kForewarning;
  });
}

FailureNotice judge_failure(const TrueFailure& failure, double next_start,
                            const std::vector<Span>& alarms,
                            const std::vector<TrueFailure>& failures) {
  FailureNotice notice;
  notice.failure = failure;
  double noticed = 0;
  for (const Span& alarm : alarms) {
    if (!touches(alarm, failure)) continue;
    const double begin = std::max(alarm.begin, failure.start);
    if (begin <= failure.end) {
      noticed += std::min(alarm.end, failure.end) - begin;
      const bool detects = is_alarm_of_any(alarm, failures);
      if (detects && !notice.detection_delay) notice.detection_delay = begin - failure.start;
    }
    notice.recovery_delay.reset();
    if (alarm.over && alarm.end < next_start) {
      notice.recovery_delay = std::max(0.0, alarm.end - failure.end);
    }
  }
  notice.missed_share = 1 - noticed / (failure.end - failure.start);
  return notice;
}

struct StateSample {
  double time;  // seconds
  Eigen::Vector3d position;
  Eigen::Vector3d truth;
};

std::vector<StateSample> states(const PoseChannel& state, const PoseEvaluation& evaluation,
                                std::int64_t zero) {
  std::vector<StateSample> result;
  for (std::size_t i = 0; i < state.fixes.size(); ++i) {
    const PoseFix& fix = state.fixes[i];
    const auto status = static_cast<std::size_t>(fix.status);
    const bool known = fix.status >= 0 && status < state.statuses.size() &&
                       std::string_view(state.statuses[status].name) != "INITIALISING";
    const auto& truth = evaluation.fixes[i].truth;
    if (!known || !truth) continue;
    result.push_back({seconds(fix.utime, zero), fix.pose.translation, truth->translation});
  }
  return result;
}

template <class Predicate>
Statistics errors_where(const std::vector<StateSample>& states, Predicate within) {
  std::vector<double> errors;
  for (const StateSample& sample : states) {
    if (within(sample.time)) errors.push_back((sample.position - sample.truth).norm());
  }
  return statistics(errors);
}

// KEY.jump: the largest step from one state to the next in the given time; KEY.jump_of_truth: what
// the capsule moved in that step.
void set_jump(Metrics& metrics, const std::string& key, const std::vector<StateSample>& states,
              const Span& span) {
  double largest = -1;
  double true_step = 0;
  for (std::size_t i = 1; i < states.size(); ++i) {
    if (states[i].time < span.begin || states[i].time > span.end) continue;
    const double step = (states[i].position - states[i - 1].position).norm();
    if (step <= largest) continue;
    largest = step;
    true_step = (states[i].truth - states[i - 1].truth).norm();
  }
  if (largest < 0) return;
  metrics.set(key + ".jump", largest);
  metrics.set(key + ".jump_of_truth", true_step);
}

// The largest of the values that were seen.
class Worst {
 public:
  void see(double value) { value_ = std::max(value_.value_or(value), value); }
  void set(Metrics& metrics, const std::string& key) const {
    if (value_) metrics.set(key, *value_);
  }

 private:
  std::optional<double> value_;
};

}  // namespace

TrueFailure parse_failure(const std::string& text) {
  TrueFailure failure;
  const std::size_t colon = text.find(':');
  int used = 0;
  if (colon != std::string::npos && colon > 0) {
    failure.sensor = text.substr(0, colon);
    const char* span = text.c_str() + colon + 1;
    if (std::sscanf(span, "%lf-%lf%n", &failure.start, &failure.end, &used) == 2 &&
        span[used] == '\0' && failure.start >= 0 && failure.end > failure.start &&
        std::isfinite(failure.end)) {
      return failure;
    }
  }
  throw std::invalid_argument("\"" + text +
                              "\" is no failure; write SENSOR:START-END in seconds from the first "
                              "pose, for example visual:7-13");
}

SensorVerdict judge_sensor(const std::string& sensor, const std::vector<SensorHealth>& health,
                           const std::vector<TrueFailure>& failures, std::int64_t zero,
                           double threshold) {
  const std::vector<TrueFailure> own = failures_of(sensor, failures);
  const std::vector<Span> found = alarms(health, zero, threshold);
  SensorVerdict verdict;
  for (std::size_t i = 0; i < own.size(); ++i) {
    const double next_start =
        i + 1 < own.size() ? own[i + 1].start : std::numeric_limits<double>::infinity();
    verdict.notices.push_back(judge_failure(own[i], next_start, found, own));
  }
  for (const Span& alarm : found) {
    if (is_alarm_of_any(alarm, own)) continue;
    ++verdict.false_alarms;
    double end = alarm.end;
    for (const TrueFailure& failure : own) {
      if (failure.start > alarm.begin) end = std::min(end, failure.start);
    }
    verdict.false_alarm_seconds += end - alarm.begin;
  }
  return verdict;
}

std::vector<std::string> set_failure_metrics(Metrics& metrics, const SensorHealthSeries& health,
                                             const PoseChannel& state,
                                             const PoseEvaluation& evaluation,
                                             const std::vector<TrueFailure>& failures,
                                             std::int64_t zero, double threshold) {
  std::vector<std::string> notes;
  for (const TrueFailure& failure : failures) {
    if (health.contains(failure.sensor)) continue;
    std::string names;
    for (const auto& [name, samples] : health) names += (names.empty() ? "" : ", ") + name;
    notes.push_back(
        "CAPSULE_STATE says nothing of a sensor \"" + failure.sensor +
        "\", which is given as failed; it speaks of: " + (names.empty() ? "none" : names));
  }
  const std::vector<StateSample> samples = states(state, evaluation, zero);
  const std::vector<Span> troubled = troubles(health, failures, zero, threshold);
  const Statistics nominal = errors_where(samples, [&troubled](double time) {
    return std::none_of(troubled.begin(), troubled.end(), [time](const Span& trouble) {
      return time >= trouble.begin && time <= trouble.end + kRecoveryTime;
    });
  });
  metrics.set("failure.threshold", threshold);
  if (nominal.count > 0) {
    metrics.set("failure.nominal.error.rmse", nominal.rmse);
    metrics.set("failure.nominal.error.max", nominal.max);
  }

  std::size_t undetected = 0;
  std::size_t unrecovered = 0;
  std::size_t false_alarms = 0;
  Worst detection;
  Worst recovery;
  Worst ratio;
  for (const auto& [name, series] : health) {
    const SensorVerdict verdict = judge_sensor(name, series, failures, zero, threshold);
    int number = 0;
    for (const FailureNotice& notice : verdict.notices) {
      const auto& [sensor, start, end] = notice.failure;
      const std::string key = "failure." + name + "." + std::to_string(++number);
      metrics.set(key + ".start", start);
      metrics.set(key + ".end", end);
      if (notice.detection_delay) {
        metrics.set(key + ".detection_delay", *notice.detection_delay);
        detection.see(*notice.detection_delay);
      } else {
        ++undetected;
      }
      if (notice.recovery_delay) {
        metrics.set(key + ".recovery_delay", *notice.recovery_delay);
        recovery.see(*notice.recovery_delay);
      } else if (notice.missed_share < 1) {
        ++unrecovered;
      }
      metrics.set(key + ".missed_share", notice.missed_share);
      const auto error_until = [&, begin = start](double limit) {
        return errors_where(samples, [=](double time) { return time >= begin && time <= limit; });
      };
      const Statistics inside = error_until(end);
      if (inside.count > 0) {
        metrics.set(key + ".error.rmse", inside.rmse);
        metrics.set(key + ".error.max", inside.max);
      }
      if (inside.count > 0 && nominal.count > 0) {
        metrics.set(key + ".ratio_to_nominal", inside.rmse / nominal.rmse);
        const double limit = std::min(end, start + kCarriesOn);
        const double early = error_until(limit).rmse / nominal.rmse;
        metrics.set(key + ".ratio_to_nominal_15s", early);
        const bool alone =
            std::none_of(failures.begin(), failures.end(), [&](const TrueFailure& other) {
              return other.sensor != name && other.start < limit && other.end > start;
            });
        if (alone) ratio.see(early);
      }
      const double back = end + notice.recovery_delay.value_or(0);
      set_jump(metrics, key, samples, {std::max(end, back - kJumpTime), back + kJumpTime});
    }
    metrics.set_count("failure." + name + ".false_alarms.count", verdict.false_alarms);
    metrics.set("failure." + name + ".false_alarms.seconds", verdict.false_alarm_seconds);
    false_alarms += verdict.false_alarms;
  }
  metrics.set_count("failure.false_alarms", false_alarms);
  if (!failures.empty()) {
    metrics.set_count("failure.undetected", undetected);
    metrics.set_count("failure.unrecovered", unrecovered);
  }
  detection.set(metrics, "failure.worst.detection_delay");
  recovery.set(metrics, "failure.worst.recovery_delay");
  ratio.set(metrics, "failure.worst.ratio_to_nominal_15s");
  if (failures.empty() && false_alarms > 0) {
    notes.push_back("no --failure was given: whenever the fusion held a sensor for failed (" +
                    std::to_string(false_alarms) + " times) counts as a false alarm");
  }
  return notes;
}

}  // namespace gastronaut::evaluation

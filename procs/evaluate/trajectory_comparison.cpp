#include "evaluate/trajectory_comparison.hpp"

#include <spdlog/fmt/fmt.h>

#include <cmath>
#include <filesystem>
#include <numbers>
#include <stdexcept>

#include "evaluate/pose_channel.hpp"
#include "evaluate/report.hpp"
#include "process/version.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr const char* kName = "ESTIMATE";

// Pairs by time start at every pose and only then lose those without truth, as in the TUM
// benchmark; others are chosen among the poses with truth, as in evo.
MatchedTrajectory for_relative_errors(const MatchedTrajectory& matched, DeltaUnit unit) {
  return unit == DeltaUnit::kSeconds ? matched : matched.only_matched();
}

PairSelection pair_selection(const TrajectoryComparison& comparison) {
  PairSelection selection{parse_delta(comparison.delta), comparison.all_pairs,
                          comparison.pairs_along_truth};
  if (selection.delta.unit == DeltaUnit::kSeconds) {
    selection.tolerance = std::numeric_limits<double>::infinity();
  }
  return selection;
}

std::string table(const std::string& title, const Statistics& all, double factor) {
  return fmt::format(
      "{}\n{:>10} {:.10f}\n{:>10} {:.10f}\n{:>10} {:.10f}\n{:>10} {:.10f}\n{:>10} {:.10f}\n"
      "{:>10} {:.10f}\n{:>10} {:.10f}\n\n",
      title, "max", factor * all.max, "mean", factor * all.mean, "median", factor * all.median,
      "min", factor * all.min, "rmse", factor * all.rmse, "sse",
      factor * factor * all.sum_of_squares, "std", factor * all.std);
}

}  // namespace

ComparedTrajectories compare_trajectories(const TrajectoryComparison& comparison) {
  const PairSelection selection = pair_selection(comparison);
  const Trajectory estimate = read_trajectory(comparison.estimate, comparison.format);
  const Trajectory truth = read_trajectory(comparison.truth, comparison.format);
  ComparedTrajectories result;
  if (comparison.format == TrajectoryFormat::kKitti) {
    result.matched = match_by_index(estimate, truth);
  } else {
    constexpr double kMicroseconds = 1e6;
    result.matched =
        match(estimate, truth,
              static_cast<std::int64_t>(std::llround(comparison.max_difference * kMicroseconds)));
  }
  const std::size_t pairs = result.matched.count_matched();
  if (pairs == 0) {
    throw std::runtime_error(
        fmt::format("no pose of {} lies within {} s of one of {}; are these the same recording?",
                    comparison.estimate, comparison.max_difference, comparison.truth));
  }
  const std::string name = kName;
  result.metrics.set("run.log", std::filesystem::path(comparison.estimate).filename().string());
  result.metrics.set("run.ground_truth",
                     std::filesystem::path(comparison.truth).filename().string());
  result.metrics.set("run.evaluate_version", code_version());
  result.metrics.set("run.time_unit",
                     comparison.format == TrajectoryFormat::kKitti ? "frames" : "seconds");
  result.metrics.set_count(name + ".count", estimate.size());
  result.metrics.set_count(name + ".with_truth", pairs);
  set_absolute_errors(result.metrics, name + ".ate", result.matched);
  const MatchedTrajectory relative = for_relative_errors(result.matched, selection.delta.unit);
  set_relative_errors(result.metrics, name + ".rpe." + comparison.delta, {&relative, 1}, selection);
  return result;
}

std::string describe(const TrajectoryComparison& comparison, const ComparedTrajectories& compared) {
  const MatchedTrajectory& matched = compared.matched;
  std::string text = fmt::format("{} of {} poses have a true one\n\n", matched.count_matched(),
                                 matched.estimate.size());
  const auto absolute = [&](const char* how, AlignmentKind kind) {
    const Alignment alignment = align(matched, kind);
    text += table(
        fmt::format(
            "APE w.r.t. translation part (m), {}{}", how,
            kind == AlignmentKind::kSim3 ? fmt::format(", scale {:.9f}", alignment.scale) : ""),
        statistics(absolute_errors(matched, alignment)), 1);
    if (!alignment.rotation_determined) {
      text += "(the positions lie on a line: the alignment's rotation about it is arbitrary)\n\n";
    }
  };
  absolute("not aligned", AlignmentKind::kNone);
  absolute("SE(3) Umeyama alignment", AlignmentKind::kSe3);
  absolute("Sim(3) Umeyama alignment", AlignmentKind::kSim3);
  const PairSelection selection = pair_selection(comparison);
  const MatchedTrajectory relative = for_relative_errors(matched, selection.delta.unit);
  const RelativeErrors errors = relative_errors(relative, select_pairs(relative, selection));
  if (errors.translation.empty()) {
    return text + "RPE: no two poses are " + comparison.delta + " apart\n";
  }
  const std::string how =
      fmt::format("delta {}, {} pairs, not aligned", comparison.delta, errors.translation.size());
  text += table("RPE w.r.t. translation part (m), " + how, statistics(errors.translation), 1);
  text += table("RPE w.r.t. rotation part (degrees), " + how, statistics(errors.rotation),
                180 / std::numbers::pi);
  return text;
}

void write_comparison(const TrajectoryComparison& comparison, const ComparedTrajectories& compared,
                      const std::string& folder) {
  const MatchedTrajectory matched = compared.matched.only_matched();
  PoseChannel channel{kName, PoseKind::kCameraInMap, 0, {{"OK", true}}, {}, {}};
  TruthTrack truth;
  const auto to_se3 = [](const Pose& pose) {
    return SE3{Eigen::Quaterniond(pose.rotation).normalized(), pose.translation};
  };
  for (std::size_t i = 0; i < matched.estimate.size(); ++i) {
    const std::int64_t utime = matched.estimate.utimes[i];
    channel.fixes.push_back({utime, 0, to_se3(matched.estimate.poses[i]), {}});
    truth.add(utime, to_se3(*matched.truth[i]));
  }
  const PoseEvaluation evaluation = evaluate_pose_channel(channel, truth, SE3{});
  write_pose_series(folder + "/" + kName + ".csv", channel, evaluation, {});
  write_truth_series(folder + "/GROUND_TRUTH_POSE.csv", truth);
  if (comparison.format == TrajectoryFormat::kTum) {
    write_tum(folder + "/" + kName + ".tum", compared.matched.estimate);
  }
  write_metrics(folder + "/metrics.json", compared.metrics);
}

}  // namespace gastronaut::evaluation

#include "evaluate/log_evaluation.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <numbers>

#include "evaluate/cramer_rao.hpp"
#include "evaluate/evaluate_process.hpp"
#include "evaluate/map_evaluation.hpp"
#include "evaluate/path_comparison.hpp"
#include "evaluate/picture_evaluation.hpp"
#include "evaluate/report.hpp"
#include "numerics/parallel.hpp"
#include "process/channels.hpp"
#include "process/progress.hpp"
#include "process/version.hpp"
#include "trajectory/trajectory_file.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr double kDegreesPerRadian = 180 / std::numbers::pi;

void set_run_metrics(Metrics& metrics, const RecordedRun& run, const std::string& log) {
  metrics.set("run.log", std::filesystem::path(log).filename().string());
  metrics.set("run.configuration",
              run.configuration_name.empty() ? "unknown" : run.configuration_name);
  metrics.set("run.code_version", run.code_version.empty() ? "unknown" : run.code_version);
  metrics.set("run.evaluate_version", code_version());
  metrics.set("run.seconds", static_cast<double>(run.last_utime - run.first_utime) * 1e-6);
  metrics.set("run.damage", run.damage);
  for (const auto& [name, count] : run.channels) {
    metrics.set_count("messages." + name + ".count", count.messages);
    metrics.set_count("messages." + name + ".bytes", count.bytes);
    if (count.corrupt > 0) metrics.set_count("messages." + name + ".corrupt", count.corrupt);
  }
}

std::vector<BoundSample> cramer_rao_bounds(const RecordedRun& run) {
  std::vector<BoundSample> samples(run.hall_readings.size());
  const CramerRaoBound configured(*run.configuration, CramerRaoBound::Noise::kConfigured);
  const CramerRaoBound sensor_only(*run.configuration, CramerRaoBound::Noise::kSensorOnly);
  const SE3 camera_T_magnet = run.configuration->camera_T_magnet.transform();
  constexpr std::size_t kChunk = 64;
  parallel_for_chunks(samples.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const HallReading& reading = run.hall_readings[i];
      const auto rig_T_camera = run.truth.at(reading.utime);
      samples[i].utime = reading.utime;
      samples[i].position = std::nan("");
      if (!rig_T_camera) continue;
      const SE3 rig_T_magnet = *rig_T_camera * camera_T_magnet;
      const Eigen::Vector3d axis = rig_T_magnet.rotation * Eigen::Vector3d::UnitZ();
      const auto bound = [&](const CramerRaoBound& of, double& position, double& angle) {
        const Matrix5d covariance =
            of.covariance(rig_T_magnet.translation, axis, reading.unusable_channels);
        position = std::sqrt(covariance.diagonal().head<3>().sum());
        angle = std::sqrt(covariance.diagonal().tail<2>().sum());
      };
      bound(configured, samples[i].position, samples[i].axis);
      bound(sensor_only, samples[i].position_sensor_noise_only, samples[i].axis_sensor_noise_only);
    }
  });
  std::erase_if(samples, [](const BoundSample& sample) { return std::isnan(sample.position); });
  std::stable_sort(samples.begin(), samples.end(),
                   [](const auto& a, const auto& b) { return a.utime < b.utime; });
  return samples;
}

double root_mean_square(const std::vector<double>& values) { return statistics(values).rmse; }

// The bound over all readings with truth, and over those with an OK fix our error against it.
void set_bound_metrics(Metrics& metrics, const std::vector<BoundSample>& bounds,
                       const PoseChannel* magnetic, const PoseEvaluation* evaluation) {
  const std::string name = channel::kMagneticPose;
  std::map<std::int64_t, std::size_t> fix_of_utime;
  if (magnetic != nullptr) {
    for (std::size_t i = 0; i < magnetic->fixes.size(); ++i) {
      if (!magnetic->usable(magnetic->fixes[i]) || !evaluation->fixes[i].truth) continue;
      fix_of_utime[magnetic->fixes[i].utime] = i;
    }
  }
  const auto set = [&](const std::string& key, double BoundSample::*position,
                       double BoundSample::*axis) {
    std::vector<double> all_positions;
    std::vector<double> all_axes;
    std::vector<double> positions;
    std::vector<double> axes;
    std::vector<double> position_errors;
    std::vector<double> axis_errors;
    for (const BoundSample& bound : bounds) {
      all_positions.push_back(bound.*position);
      all_axes.push_back(bound.*axis);
      const auto fix = fix_of_utime.find(bound.utime);
      if (fix == fix_of_utime.end()) continue;
      positions.push_back(bound.*position);
      axes.push_back(bound.*axis);
      position_errors.push_back(evaluation->fixes[fix->second].position.norm());
      axis_errors.push_back(evaluation->fixes[fix->second].rotation);
    }
    metrics.set(key + ".position_rms", root_mean_square(all_positions));
    metrics.set(key + ".axis_rms_deg", kDegreesPerRadian * root_mean_square(all_axes));
    metrics.set_count(key + ".count", all_positions.size());
    if (positions.empty()) return;
    metrics.set_count(key + ".count_of_fixes", positions.size());
    metrics.set(key + ".position_ratio",
                root_mean_square(position_errors) / root_mean_square(positions));
    metrics.set(key + ".axis_ratio", root_mean_square(axis_errors) / root_mean_square(axes));
  };
  if (bounds.empty()) return;
  set(name + ".cramer_rao", &BoundSample::position, &BoundSample::axis);
  set(name + ".cramer_rao_sensor_noise_only", &BoundSample::position_sensor_noise_only,
      &BoundSample::axis_sensor_noise_only);
}

// How far the magnet is from the nearest sensor, and the errors of the fixes within 5 cm, for which
// targets are given.
void set_distance_metrics(Metrics& metrics, const RigConfiguration& configuration,
                          const PoseChannel& magnetic, const PoseEvaluation& evaluation) {
  constexpr double kNear = 0.05;  // metres
  const auto sensors = configuration.hall_array.resolved_sensors();
  std::vector<double> distances;
  std::vector<double> position;
  std::vector<double> rotation;
  for (std::size_t i = 0; i < magnetic.fixes.size(); ++i) {
    const FixErrors& errors = evaluation.fixes[i];
    if (!errors.truth) continue;
    double nearest = std::numeric_limits<double>::infinity();
    for (const HallSensorConfiguration& sensor : sensors) {
      nearest = std::min(nearest, (sensor.position - errors.truth->translation).norm());
    }
    distances.push_back(nearest);
    if (nearest > kNear || !magnetic.usable(magnetic.fixes[i])) continue;
    position.push_back(errors.position.norm());
    rotation.push_back(errors.rotation);
  }
  metrics.set_statistics(magnetic.name + ".sensor_distance", distances);
  metrics.set_count(magnetic.name + ".within_5cm.count", position.size());
  metrics.set_statistics(magnetic.name + ".within_5cm.position", position);
  metrics.set_statistics(magnetic.name + ".within_5cm.axis_deg", rotation, kDegreesPerRadian);
}

// The utime from which the report counts seconds.
std::int64_t first_measurement(const RecordedRun& run) {
  std::int64_t first = std::numeric_limits<std::int64_t>::max();
  if (!run.truth.empty()) first = run.truth.first();
  for (const PoseChannel& channel : run.pose_channels) {
    first = std::min(first, channel.fixes.front().utime);
  }
  if (!run.depth.frames.empty()) first = std::min(first, run.depth.frames.front().utime);
  return first;
}

double failure_threshold(const RecordedRun& run) {
  return run.configuration.value_or(RigConfiguration{}).sensor_fusion.failure_threshold;
}

Trajectory truth_trajectory(const TruthTrack& truth, const SE3& camera_T_target) {
  Trajectory trajectory;
  trajectory.utimes = truth.utimes();
  for (const SE3& pose : truth.poses()) {
    trajectory.poses.push_back(to_pose(pose * camera_T_target));
  }
  return trajectory;
}

}  // namespace

Metrics evaluate_log(const std::string& log, const std::string& folder,
                     const std::vector<std::size_t>& frames, const std::string& surface,
                     const std::vector<TrueFailure>& failures, const std::string& surface_pairs) {
  RecordedRun run;
  {
    Progress progress("reading " + log);
    run = read_run(log, [&progress](double fraction) { progress.update(fraction); });
  }
  Metrics metrics;
  set_run_metrics(metrics, run, log);

  const SE3 camera_T_magnet =
      run.configuration ? run.configuration->camera_T_magnet.transform() : SE3{};
  if (!run.truth.empty()) {
    write_tum(folder + "/GROUND_TRUTH_POSE.tum", truth_trajectory(run.truth, SE3{}));
    write_truth_series(folder + "/GROUND_TRUTH_POSE.csv", run.truth);
  }
  std::vector<BoundSample> bounds;
  if (run.configuration) bounds = cramer_rao_bounds(run);
  const TruthTrack nothing;
  bool bounds_set = false;
  bool with_state = false;
  std::vector<PoseEvaluation> evaluations;
  evaluations.reserve(run.pose_channels.size());  // they are referred to
  std::vector<ComparedChannel> compared;
  for (const PoseChannel& channel : run.pose_channels) {
    const bool magnet = channel.kind == PoseKind::kMagnet;
    const bool comparable = !magnet || run.configuration.has_value();
    const PoseEvaluation& evaluation = evaluations.emplace_back(evaluate_pose_channel(
        channel, comparable ? run.truth : nothing, magnet ? camera_T_magnet : SE3{}));
    set_pose_metrics(metrics, channel, evaluation);
    if (comparable && channel.name != channel::kCapsulePose) {
      compared.push_back({channel.name, evaluation.usable, channel.kind != PoseKind::kCameraInMap});
    }
    if (comparable && evaluation.frames > 1 && !run.truth.empty()) {
      run.notes.push_back(channel.name + " has " + std::to_string(evaluation.frames) +
                          " map frames (map_version): each was aligned with the truth by itself, "
                          "so its errors say nothing of how the frames lie to each other");
    }
    if (channel.name == channel::kCapsuleState) {
      for (const std::string& note :
           set_failure_metrics(metrics, run.sensor_health, channel, evaluation, failures,
                               first_measurement(run), failure_threshold(run))) {
        run.notes.push_back(note);
      }
      write_sensor_health(folder + "/sensor_health.csv", run.sensor_health);
      with_state = true;
    }
    write_tum(folder + "/" + channel.name + ".tum", evaluation.usable.estimate);
    if (magnet) {
      write_tum(folder + "/GROUND_TRUTH_MAGNET.tum", truth_trajectory(run.truth, camera_T_magnet));
      if (run.configuration) {
        set_distance_metrics(metrics, *run.configuration, channel, evaluation);
      }
      set_bound_metrics(metrics, bounds, &channel, &evaluation);
      bounds_set = true;
    }
    write_pose_series(
        folder + "/" + channel.name + ".csv", channel, evaluation,
        magnet ? std::span<const BoundSample>(bounds) : std::span<const BoundSample>());
  }
  if (!failures.empty() && !with_state) {
    run.notes.push_back("--failure was given, but the log has no CAPSULE_STATE (sensor_fusion)");
  }
  set_comparison_metrics(metrics, run.truth, compared);
  if (!bounds_set) set_bound_metrics(metrics, bounds, nullptr, nullptr);
  set_depth_metrics(metrics, run.depth);
  if (!run.depth.frames.empty()) write_depth_series(folder, run.depth);
  const std::vector<ShownFrame> shown = evaluate_pictures(metrics, log, folder, frames, run);
  evaluate_map(metrics, log, folder, surface, surface_pairs, shown, run);
  if (!set_timing_metrics(metrics, log + ".timing.json")) {
    run.notes.push_back("there is no " + std::filesystem::path(log).filename().string() +
                        ".timing.json beside the log (replay writes it): no times per event");
  }
  int number = 0;
  for (const std::string& note : run.notes) metrics.set("note." + std::to_string(++number), note);
  write_metrics(folder + "/metrics.json", metrics);
  return metrics;
}

}  // namespace gastronaut::evaluation

// usage: fusion_consistency [--seeds N] [--scenario FILE] [--set key=value...]
// Whether CAPSULE_STATE's covariance can be believed: the normalised error squared (NEES) over many
// virtual rigs, each with its own sensor errors, noise, path and error of the hand-eye calibration.
// Magnetics are the virtual rig's and the localiser's; vision is the true pose in a map of its own,
// drifting as visual_slam was measured to (BeliefModel), because 100 recordings with pictures take
// hours.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bus/memory_bus.hpp"
#include "bus/wire.hpp"
#include "evaluate/consistency.hpp"
#include "gastronaut/capsule_state_t.hpp"
#include "gastronaut/rig_config_t.hpp"
#include "gastronaut/rigid_transform_t.hpp"
#include "gastronaut/visual_pose_t.hpp"
#include "magnetic_localizer/magnetic_localizer_process.hpp"
#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"
#include "process/channels.hpp"
#include "process/command_line.hpp"
#include "sensor_fusion/sensor_fusion_process.hpp"
#include "virtual_rig/virtual_rig_process.hpp"

namespace gastronaut {
namespace {

constexpr std::int64_t kStart = 1'700'000'000'000'000;
constexpr int kChecks = 8;  // times in a run at which errors are looked at, evenly

// Camera poses as vision would give them: another frame, another scale, drift along the path.
class DriftingVision {
 public:
  DriftingVision(std::uint64_t seed, double working_distance)
      : random_(seed, 7), distance_(working_distance) {
    constexpr double kScaleStd = 0.03;
    scale_ = std::exp(kScaleStd * normal());
  }

  SE3 see(const SE3& rig_T_camera) {
    if (last_) {
      const SE3 moved = last_->inverse() * rig_T_camera;
      const double path = moved.translation.norm() / distance_ +
                          angle_between(moved.rotation, Eigen::Quaterniond::Identity());
      map_T_camera_ = map_T_camera_ * SE3{moved.rotation, moved.translation / scale_} *
                      SE3::exp(noise(model_.drift_position * std::sqrt(path),
                                     model_.drift_rotation * std::sqrt(path)));
      scale_ *= std::exp(model_.drift_scale * std::sqrt(path) * normal());
    }
    last_ = rig_T_camera;
    return map_T_camera_ * SE3::exp(noise(model_.visual_position_std, model_.visual_rotation_std));
  }

 private:
  double normal() { return random_.normal(next_++); }
  // Rotations swing the camera about what it sees; position_std in distances.
  Vector6d noise(double position_std, double rotation_std) {
    Vector6d twist;
    for (int i = 0; i < 6; ++i) twist(i) = normal();
    const Eigen::Vector3d rotation = rotation_std * twist.tail<3>();
    twist.head<3>() =
        distance_ * (position_std * twist.head<3>() + Eigen::Vector3d::UnitZ().cross(rotation));
    twist.tail<3>() = rotation;
    return twist;
  }

  CounterRandom random_;
  std::uint64_t next_ = 0;
  double distance_;
  fusion::BeliefModel model_;
  SE3 map_T_camera_;
  double scale_ = 1;
  std::optional<SE3> last_;
};

struct Check {
  double normalised = 0;  // NEES, 6 numbers
  double position = 0;    // metres
  double rotation = 0;    // radians
};

struct Run {
  std::vector<Check> checks;
  int failures = 0;  // states that say a sensor has failed
};

visual_pose_t to_message(const SE3& map_T_camera, std::int64_t utime) {
  constexpr double kStd = 1e-4;
  visual_pose_t message{};
  message.utime = utime;
  const Eigen::Quaterniond& q = map_T_camera.rotation;
  const double wxyz[] = {q.w(), q.x(), q.y(), q.z()};
  std::copy_n(map_T_camera.translation.data(), 3, message.position);
  std::copy_n(wxyz, 4, message.orientation);
  for (int i = 0; i < 6; ++i) message.covariance[i][i] = kStd * kStd;
  return message;
}

Check check(const capsule_state_t& state, const SE3& truth) {
  const double* q = state.orientation;
  const Eigen::Quaterniond rotation(q[0], q[1], q[2], q[3]);
  Vector6d error;
  error << Eigen::Vector3d(state.position) - truth.translation,
      so3_log(truth.rotation.conjugate() * rotation);
  Matrix6d covariance;
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) covariance(i, j) = state.covariance[i][j];
  }
  return {evaluation::normalised_error_squared(error, covariance).value_or(std::nan("")),
          error.head<3>().norm(), error.tail<3>().norm()};
}

// The configuration as a calibration would leave it: off by what it says of itself.
RigConfiguration miscalibrated(RigConfiguration rig, std::uint64_t seed) {
  const CounterRandom random(seed, 11);
  TransformConfiguration& mount = rig.camera_T_magnet;
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();
  for (int i = 0; i < 3; ++i) {
    const auto index = static_cast<std::uint64_t>(i);
    mount.translation(i) += rig.sensor_fusion.hand_eye_position_std * random.normal(index);
    if (i < 2) turn(i) = rig.sensor_fusion.hand_eye_axis_std * random.normal(3 + index);
  }
  const Eigen::Quaterniond q = mount.transform().rotation * so3_exp(turn);
  mount.rotation = {q.w(), q.x(), q.y(), q.z()};
  return rig;
}

Run run_seed(VirtualRigScenario scenario, std::uint64_t seed) {
  scenario.seed = seed;
  scenario.magnetics.rig_seed = seed;
  scenario.imaging.enabled = false;
  const double interval = scenario.duration / kChecks;

  std::map<std::int64_t, SE3> truths;
  Run run;
  MemoryNetwork network([&](const std::string& channel, Bytes payload, std::int64_t utime) {
    if (channel != channel::kCapsuleState) return;
    capsule_state_t state;
    if (decode_message(payload, state) != DecodeResult::kOk) return;
    const bool failed = state.status == capsule_state_t::STATUS_DEGRADED ||
                        state.status == capsule_state_t::STATUS_PREDICTING;
    if (failed) ++run.failures;
    const auto truth = truths.find(utime);
    const double due = interval * static_cast<double>(run.checks.size() + 1);
    const bool is_due = static_cast<double>(utime - kStart) * 1e-6 > due - 0.2;
    if (truth != truths.end() && is_due && run.checks.size() < kChecks) {
      run.checks.push_back(check(state, truth->second));
    }
  });
  DriftingVision vision(seed, scenario.rig.visual_slam.working_distance);
  std::vector<std::unique_ptr<Process>> processes;
  VirtualRigProcess rig(
      scenario, kStart,
      [&](const std::string& channel, const std::vector<std::uint8_t>& payload, std::int64_t) {
        rig_config_t message;
        if (processes.empty() && channel == channel::kRigConfig &&
            decode_message(payload, message) == DecodeResult::kOk) {
          const RigConfiguration told =
              miscalibrated(parse_rig_configuration(message.yaml, "RIG_CONFIG"), seed);
          for (const auto& process : {magnetic_localizer_process(), sensor_fusion_process()}) {
            processes.push_back(process.create(network.connect(), told));
          }
        }
        network.inject(channel, payload);
        rigid_transform_t pose;
        if (channel == channel::kGroundTruthPose &&
            decode_message(payload, pose) == DecodeResult::kOk) {
          const double* q = pose.quat;
          const SE3 truth{Eigen::Quaterniond(q[0], q[1], q[2], q[3]), Eigen::Vector3d(pose.trans)};
          truths[pose.utime] = truth;
          network.inject(channel::kVisualPose,
                         encode_message(to_message(vision.see(truth), pose.utime)));
        }
        network.run_until_idle();
      });
  while (rig.next_time() < scenario.duration) rig.step();
  network.finish([&](std::size_t i) { processes[i]->finish(); });
  return run;
}

void print(const std::vector<Run>& runs, double duration) {
  std::printf("%8s %6s %8s %17s %10s %10s\n", "time s", "runs", "NEES", "95 % band of it", "mm RMS",
              "deg RMS");
  for (int k = 0; k < kChecks; ++k) {
    std::vector<double> normalised;
    double position = 0;
    double rotation = 0;
    for (const Run& run : runs) {
      if (run.checks.size() <= static_cast<std::size_t>(k)) continue;
      const Check& check = run.checks[static_cast<std::size_t>(k)];
      normalised.push_back(check.normalised);
      position += check.position * check.position;
      rotation += check.rotation * check.rotation;
    }
    if (normalised.empty()) continue;
    const evaluation::Consistency nees = evaluation::consistency(normalised, 6);
    const double count = static_cast<double>(normalised.size());
    std::printf("%8.1f %6zu %8.2f %8.2f %8.2f %10.3f %10.3f\n", duration * (k + 1) / kChecks,
                normalised.size(), nees.mean, nees.band_low, nees.band_high,
                1e3 * std::sqrt(position / count), 180 / M_PI * std::sqrt(rotation / count));
  }
  int failures = 0;
  for (const Run& run : runs) failures += run.failures;
  std::printf("states that say a sensor has failed (none has): %d\n", failures);
}

}  // namespace

int run_consistency(int argc, char** argv) {
  CLI::App app("NEES of the fused pose over many virtual rigs.", "fusion_consistency");
  int seeds = 100;
  std::string file = "config/scenarios/st0.yaml";
  std::vector<std::string> settings;
  app.add_option("--seeds", seeds, "how many rigs")->check(CLI::Range(2, 10000));
  app.add_option("--scenario", file, "the virtual rig's scenario");
  app.add_option("--set", settings, "key=value of the scenario");
  return run_command_line(app, argc, argv, [&] {
    const VirtualRigScenario scenario = load_scenario(file, settings);
    std::vector<Run> runs(static_cast<std::size_t>(seeds));
    parallel_for_chunks(runs.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) runs[i] = run_seed(scenario, i + 1);
    });
    print(runs, scenario.duration);
    return kExitDone;
  });
}

}  // namespace gastronaut

int main(int argc, char** argv) { return gastronaut::run_consistency(argc, argv); }

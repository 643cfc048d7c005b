#include "sensor_fusion/sensor_fusion_process.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numbers>

#include "gastronaut/capsule_state_t.hpp"
#include "gastronaut/pose_t.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

constexpr const char* kSensorNames[fusion::kNumSensors] = {"magnetic", "visual"};
// Of 5 numbers: passed once in a thousand where the calibration fits, enough for a warning to a
// person.
constexpr double kHandEyeChi2 = 20;
constexpr double kTimeOffsetSigmas = 4;
// Less than this vision makes itself, by its errors between two keyframes.
constexpr double kLeastTimeOffset = 15e-3;  // seconds

fusion::FilterOptions options_of(const RigConfiguration& configuration) {
  const SensorFusionConfiguration& chosen = configuration.sensor_fusion;
  fusion::FilterOptions options;
  options.position_and_rotation_only = chosen.model == ObservationModel::kPaper;
  options.particles = static_cast<std::size_t>(chosen.particles);
  options.seed = chosen.seed;
  options.alpha_memory = chosen.alpha_memory;
  options.failure_threshold = chosen.failure_threshold;
  options.model.acceleration_std = chosen.acceleration_std;
  options.model.angular_acceleration_std = chosen.angular_acceleration_std;
  options.model.working_distance = configuration.visual_slam.working_distance;
  options.camera_T_magnet = configuration.camera_T_magnet.transform();
  options.hand_eye_position_std = chosen.hand_eye_position_std;
  options.hand_eye_axis_std = chosen.hand_eye_axis_std;
  options.time_offset = chosen.magnetic_time_offset;
  options.time_offset_std = chosen.magnetic_time_offset_std;
  options.depth_scale_std = chosen.depth_scale_std;
  return options;
}

double number_or_zero(const std::string& text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && std::isfinite(value) ? value : 0;
}

template <int kSize>
Eigen::Matrix<double, kSize, kSize> matrix(const double (&values)[kSize][kSize]) {
  Eigen::Matrix<double, kSize, kSize> result;
  for (int i = 0; i < kSize; ++i) {
    for (int j = 0; j < kSize; ++j) result(i, j) = values[i][j];
  }
  return result;
}

}  // namespace

SensorFusionProcess::SensorFusionProcess(Bus& bus, const RigConfiguration& configuration)
    : bus_(bus), configuration_(configuration.sensor_fusion), filter_(options_of(configuration)) {
  const double lag = configuration.lag.fusion;
  // A picture is known before what vision makes of it; of one utime the magnet comes first.
  bus.subscribe<image_t>(channel::kAlbedo, lag,
                         [this](const image_t& message) { handle_picture(message); });
  bus.subscribe<magnetic_pose_t>(
      channel::kMagneticPose, lag,
      [this](const magnetic_pose_t& message) { handle_magnetic(message); });
  bus.subscribe<visual_pose_t>(channel::kVisualPose, lag,
                               [this](const visual_pose_t& message) { handle_visual(message); });
}

void SensorFusionProcess::handle_picture(const image_t& message) {
  fusion::PictureQuality picture;
  for (const image_metadata_t& entry : message.metadata) {
    const std::string value(entry.value.begin(), entry.value.end());
    if (entry.key == "failure") picture.failure = value;
    if (entry.key == "sharpness") picture.sharpness = number_or_zero(value);
    if (entry.key == "highlight_fraction") picture.highlight_fraction = number_or_zero(value);
  }
  cause_.add(picture);
}

void SensorFusionProcess::handle_magnetic(const magnetic_pose_t& message) {
  fusion::MagneticMeasurement measurement;
  measurement.utime = message.utime;
  measurement.is_usable = message.status == magnetic_pose_t::STATUS_OK;
  measurement.cause = fusion::magnetic_cause(message.status);
  measurement.fix.position = Eigen::Vector3d(message.position);
  measurement.fix.axis = Eigen::Vector3d(message.axis);
  measurement.fix.covariance = matrix(message.covariance);
  const fusion::FusedState state = filter_.update(measurement);
  // Of one utime there is one state: that with vision in it.
  if (!bus_.more_at_this_time()) publish(state);
}

void SensorFusionProcess::handle_visual(const visual_pose_t& message) {
  fusion::VisualMeasurement measurement;
  measurement.utime = message.utime;
  measurement.map_version = message.map_version;
  measurement.is_usable = message.status == visual_pose_t::STATUS_OK ||
                          message.status == visual_pose_t::STATUS_DEGRADED ||
                          message.status == visual_pose_t::STATUS_RELOCALISED;
  measurement.is_degraded = message.status == visual_pose_t::STATUS_DEGRADED;
  measurement.cause = cause_.describe(!measurement.is_usable);
  measurement.map_T_camera.translation = Eigen::Vector3d(message.position);
  const double* q = message.orientation;
  measurement.map_T_camera.rotation = Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  measurement.covariance = matrix(message.covariance);
  publish(filter_.update(measurement));
}

void SensorFusionProcess::publish(const fusion::FusedState& state) {
  capsule_state_t message{};
  message.utime = state.utime;
  message.status = static_cast<std::int8_t>(state.status);
  const Eigen::Quaterniond& q = state.rig_T_camera.rotation;
  const double wxyz[] = {q.w(), q.x(), q.y(), q.z()};
  std::copy_n(state.rig_T_camera.translation.data(), 3, message.position);
  std::copy_n(wxyz, 4, message.orientation);
  std::copy_n(state.velocity.data(), 3, message.velocity);
  std::copy_n(state.angular_velocity.data(), 3, message.angular_velocity);
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) message.covariance[i][j] = state.covariance(i, j);
  }
  message.depth_scale = state.depth_scale;
  for (std::size_t i = 0; i < fusion::kNumSensors; ++i) {
    const fusion::SensorHealth& health = state.sensors[i];
    sensor_health_t sensor;
    sensor.name = kSensorNames[i];
    sensor.p_nominal = health.nominal;
    sensor.alpha = health.alpha;
    sensor.used = health.is_used ? 1 : 0;
    sensor.cause = health.cause;
    message.sensors.push_back(std::move(sensor));
  }
  message.num_sensors = static_cast<std::int32_t>(message.sensors.size());
  bus_.publish(channel::kCapsuleState, message);

  pose_t pose{};
  pose.utime = state.utime;
  std::copy_n(message.position, 3, pose.pos);
  std::copy_n(message.velocity, 3, pose.vel);
  std::copy_n(wxyz, 4, pose.orientation);
  std::copy_n(message.angular_velocity, 3, pose.rotation_rate);
  bus_.publish(channel::kCapsulePose, pose);
  report(state);
}

void SensorFusionProcess::report(const fusion::FusedState& state) {
  std::string text;
  const auto add = [&text](const std::string& more) { text += (text.empty() ? "" : "; ") + more; };
  for (std::size_t i = 0; i < fusion::kNumSensors; ++i) {
    if (state.sensors[i].cause.empty()) continue;
    add(fmt::format("the {} sensor has failed: {}", kSensorNames[i], state.sensors[i].cause));
  }
  if (state.status == fusion::FusionStatus::kInitialising) {
    add("the roll about the magnet's axis is not known yet: move and turn the capsule");
  }
  const fusion::CalibrationCheck check = filter_.check_calibration();
  const bool fits = check.hand_eye_chi2 < kHandEyeChi2;
  if (!fits) {
    const Eigen::Vector3d millimetres = 1e3 * check.magnet_position;
    add(
        fmt::format("camera_T_magnet no longer fits: the magnet seems to be at ({:.1f}, {:.1f}, "
                    "{:.1f}) mm, its axis {:.1f} degrees off; run calibrate hand-eye",
                    millimetres.x(), millimetres.y(), millimetres.z(),
                    check.axis_change * 180 / std::numbers::pi));
  }
  const double late = check.clock.offset - configuration_.magnetic_time_offset;
  const bool in_time =
      std::abs(late) < std::max(kLeastTimeOffset, kTimeOffsetSigmas * check.clock.std);
  if (!in_time) {
    add(
        fmt::format("the clocks of magnet and camera differ by {:.1f} ms more than configured: set "
                    "sensor_fusion.magnetic_time_offset, or run calibrate hand-eye",
                    1e3 * late));
  }
  const bool well = state.status == fusion::FusionStatus::kNominal && fits && in_time;
  bus_.set_health(well ? ProcessState::kRunning : ProcessState::kDegraded, text);
}

ProcessDescription sensor_fusion_process() {
  return {"sensor_fusion",
          "Fuses magnet and vision into the capsule's pose, and tells which of them has failed.",
          channel::kMagneticPose,
          [](const RigConfiguration&) {
            return std::vector<std::string>{channel::kCapsuleState, channel::kCapsulePose};
          },
          [](Bus& bus, const RigConfiguration& configuration) {
            return std::make_unique<SensorFusionProcess>(bus, configuration);
          },
          {}};
}

}  // namespace gastronaut

#include "calibrate/hand_eye_calibration_process.hpp"

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <map>
#include <optional>

#include "bus/log_file.hpp"
#include "calibrate/calibration_readings.hpp"
#include "calibrate/hand_eye_report.hpp"
#include "configuration/rig_configuration.hpp"
#include "gastronaut/magnetic_pose_t.hpp"
#include "gastronaut/rig_config_t.hpp"
#include "gastronaut/visual_pose_t.hpp"
#include "process/channels.hpp"
#include "process/command_line.hpp"
#include "process/progress.hpp"

namespace gastronaut {
namespace {

constexpr double kMostPoseGap = 0.2;  // seconds between visual poses that are still bridged

// What of the log is used, by utime.
struct HandEyeLog {
  std::map<std::int64_t, magnetic_pose_t> fixes;
  std::map<std::int64_t, visual_pose_t> frames;
  std::optional<std::string> rig_yaml;
  std::int64_t other_fixes = 0;   // whose status says that they are not to be used
  std::int64_t other_frames = 0;  // likewise
};

bool is_sound(const magnetic_pose_t& fix) {
  const Eigen::Map<const Matrix5d> covariance(fix.covariance[0]);
  return Eigen::Vector3d(fix.position).allFinite() && Eigen::Vector3d(fix.axis).allFinite() &&
         Eigen::Vector3d(fix.axis).norm() > 0 && covariance.allFinite() &&
         Eigen::LLT<Matrix5d>(covariance).info() == Eigen::Success;
}

bool is_sound(const visual_pose_t& frame) {
  const Eigen::Map<const Eigen::Vector4d> orientation(frame.orientation);
  return Eigen::Vector3d(frame.position).allFinite() && orientation.allFinite() &&
         orientation.norm() > 0;
}

HandEyeLog read_log(const std::string& path) {
  HandEyeLog log;
  LogReader reader(path);
  Progress progress("reading " + path);
  std::int64_t bad = 0;
  while (const auto event = reader.next()) {
    progress.update(static_cast<double>(reader.offset()) / static_cast<double>(reader.size()));
    if (stop_requested()) throw std::runtime_error("stopped");
    const auto decode = [&](auto& message) {
      const bool good = decode_message(event->payload, message) == DecodeResult::kOk;
      if (!good) ++bad;
      return good;
    };
    if (event->channel == channel::kMagneticPose) {
      magnetic_pose_t fix;
      if (!decode(fix)) continue;
      if (fix.status != magnetic_pose_t::STATUS_OK) {
        ++log.other_fixes;
      } else if (is_sound(fix)) {
        log.fixes[fix.utime] = fix;
      } else {
        ++bad;
      }
    } else if (event->channel == channel::kVisualPose) {
      visual_pose_t frame;
      if (!decode(frame)) continue;
      if (frame.status == visual_pose_t::STATUS_LOST) {
        ++log.other_frames;
      } else if (is_sound(frame)) {
        log.frames[frame.utime] = frame;
      } else {
        ++bad;
      }
    } else if (event->channel == channel::kRigConfig) {
      rig_config_t message;
      if (decode(message)) log.rig_yaml = std::move(message.yaml);
    }
  }
  if (!reader.damage().empty()) spdlog::warn("{}: {}", path, reader.damage());
  if (bad > 0) spdlog::warn("{}: {} corrupt, foreign or impossible messages left out", path, bad);
  return log;
}

// The map's frame may have moved between versions: the version with most frames is used.
std::int32_t longest_version(const HandEyeLog& log) {
  std::map<std::int32_t, std::size_t> counts;
  for (const auto& [utime, frame] : log.frames) ++counts[frame.map_version];
  const auto most =
      std::max_element(counts.begin(), counts.end(),
                       [](const auto& a, const auto& b) { return a.second < b.second; });
  if (counts.size() > 1) {
    spdlog::warn(
        "the visual map has {} versions: the {} frames of version {} are used, {} left out",
        counts.size(), most->second, most->first, log.frames.size() - most->second);
  }
  return most->first;
}

}  // namespace

void describe_hand_eye(CLI::App& command) {
  command.footer(
      "Record the capsule while it turns widely about all three of its axes, with the wall in "
      "view\n"
      "and the magnet under the array; replay with the array's calibration; calibrate from that.\n"
      "Example: replay raw.lcmlog --config coils.yaml --config array.yaml --out derived.lcmlog\n"
      "         calibrate hand-eye derived.lcmlog --out hand_eye.yaml");
}

HandEyeTexts run_hand_eye_calibration(const HandEyeCommand& command) {
  const HandEyeLog log = read_log(command.log);
  const auto need = [&](bool there, const char* channel) {
    if (there) return;
    throw CalibrationRefused(
        fmt::format("{} has no usable poses on {}: run `replay RAW --out DERIVED` and calibrate "
                    "from DERIVED",
                    command.log, channel));
  };
  need(!log.fixes.empty(), channel::kMagneticPose);
  need(!log.frames.empty(), channel::kVisualPose);
  std::vector<YamlSource> sources;
  if (log.rig_yaml) {
    sources.push_back(parse_yaml(*log.rig_yaml, command.log + " " + channel::kRigConfig));
  }
  for (const std::string& file : command.configuration_files) {
    sources.push_back(load_yaml_file(file));
  }
  RigConfiguration rig;
  read_configuration(rig, sources, command.settings);
  spdlog::info("left out for their status: {} of {} fixes, {} of {} frames", log.other_fixes,
               log.other_fixes + static_cast<std::int64_t>(log.fixes.size()), log.other_frames,
               log.other_frames + static_cast<std::int64_t>(log.frames.size()));

  const std::int32_t version = longest_version(log);
  const std::int64_t origin = log.frames.begin()->first;
  const auto seconds = [origin](std::int64_t utime) {
    return static_cast<double>(utime - origin) * 1e-6;
  };
  std::vector<VisualFrame> frames;
  for (const auto& [utime, frame] : log.frames) {
    if (frame.map_version != version) continue;
    const double* q = frame.orientation;
    frames.push_back({seconds(utime),
                      {Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized(),
                       Eigen::Vector3d(frame.position)}});
  }
  std::vector<MagneticFix> fixes;
  for (const auto& [utime, fix] : log.fixes) {
    fixes.push_back({seconds(utime), Eigen::Vector3d(fix.position),
                     Eigen::Vector3d(fix.axis).normalized(),
                     Eigen::Map<const Matrix5d>(fix.covariance[0])});
  }
  const SE3 configured = rig.camera_T_magnet.transform();
  HandEye start;
  start.centre = configured.translation;
  start.axis = configured.rotation * Eigen::Vector3d::UnitZ();
  start.time_offset = rig.sensor_fusion.magnetic_time_offset;
  Progress progress("calibrating hand and eye");
  const HandEyeCalibration calibration = calibrate_hand_eye(
      VisualTrack(std::move(frames), kMostPoseGap), fixes, start, [&](double fraction) {
        if (stop_requested()) throw std::runtime_error("stopped");
        progress.update(fraction);
      });
  if (!calibration.advice.motion.empty()) {
    spdlog::warn("{} is known less well than it should be: {}", calibration.advice.weakest,
                 calibration.advice.motion);
  }
  return {hand_eye_fragment(calibration, configured,
                            std::filesystem::path(command.log).filename().string()),
          hand_eye_table(calibration, configured)};
}

}  // namespace gastronaut

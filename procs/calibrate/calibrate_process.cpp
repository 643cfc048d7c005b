#include "calibrate/calibrate_process.hpp"

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <map>

#include "bus/log_file.hpp"
#include "calibrate/array_calibration.hpp"
#include "calibrate/calibration_report.hpp"
#include "calibrate/coil_calibration.hpp"
#include "calibrate/hand_eye_calibration_process.hpp"
#include "calibrate/light_calibration_process.hpp"
#include "gastronaut/coil_currents_t.hpp"
#include "gastronaut/hall_array_t.hpp"
#include "gastronaut/rig_config_t.hpp"
#include "gastronaut/rigid_transform_t.hpp"
#include "magnetics/coil_field.hpp"
#include "process/channels.hpp"
#include "process/command_line.hpp"
#include "process/progress.hpp"
#include "process/whole_file.hpp"

namespace gastronaut {
namespace {

constexpr double kMostPoseGap = 0.2;  // seconds between true poses that are still bridged

struct Options {
  std::string log;
  std::string out;
  std::vector<std::string> configuration_files;
  std::vector<std::string> settings;
  std::string poses = "auto";
  ArrayCalibrationOptions array;
  // Priors given on the command line; otherwise the larger of what the configuration says is
  // unknown and what an uncalibrated array usually has.
  std::optional<double> gain_std;
  std::optional<double> alignment_std;
  std::optional<double> offset_std;
  LightCommand light;
};

// What of the log the calibrations use, by time.
struct CalibrationLog {
  std::map<std::int64_t, hall_array_t> readings;
  std::map<std::int64_t, coil_currents_t> currents;
  std::map<std::int64_t, SE3> rig_T_camera;
  std::optional<std::string> rig_yaml;
};

CalibrationLog read_log(const std::string& path) {
  LogReader reader(path);
  CalibrationLog log;
  std::int64_t bad = 0;
  Progress progress("reading " + path);
  const auto decode = [&bad](const LogReader::Event& event, auto& message) {
    const bool good = decode_message(event.payload, message) == DecodeResult::kOk;
    if (!good) ++bad;
    return good;
  };
  while (const auto event = reader.next()) {
    progress.update(static_cast<double>(reader.offset()) / static_cast<double>(reader.size()));
    if (stop_requested()) throw std::runtime_error("stopped");
    if (event->channel == channel::kHallArray) {
      hall_array_t message;
      if (decode(*event, message)) log.readings[message.utime] = std::move(message);
    } else if (event->channel == channel::kCoilCurrents) {
      coil_currents_t message;
      if (decode(*event, message)) log.currents[message.utime] = std::move(message);
    } else if (event->channel == channel::kGroundTruthPose) {
      rigid_transform_t message;
      if (!decode(*event, message)) continue;
      const double* q = message.quat;
      log.rig_T_camera[message.utime] = {Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized(),
                                         Eigen::Vector3d(message.trans)};
    } else if (event->channel == channel::kRigConfig) {
      rig_config_t message;
      if (decode(*event, message)) log.rig_yaml = std::move(message.yaml);
    }
  }
  if (!reader.damage().empty()) spdlog::warn("{}: {}", path, reader.damage());
  if (bad > 0) spdlog::warn("{}: {} corrupt or foreign messages left out", path, bad);
  if (log.readings.empty()) {
    throw std::runtime_error(path + " has no readings on " + channel::kHallArray);
  }
  return log;
}

// The log's own configuration, then the files, then the settings; nothing when there is neither.
std::optional<RigConfiguration> effective_rig(const CalibrationLog& log, const Options& options) {
  std::vector<YamlSource> sources;
  if (log.rig_yaml) {
    sources.push_back(parse_yaml(*log.rig_yaml, options.log + " " + channel::kRigConfig));
  }
  for (const std::string& file : options.configuration_files) {
    sources.push_back(load_yaml_file(file));
  }
  if (sources.empty()) return std::nullopt;
  RigConfiguration rig;
  read_configuration(rig, sources, options.settings);
  return rig;
}

std::optional<MagnetPose> magnet_at(const CalibrationLog& log, const SE3& camera_T_magnet,
                                    std::int64_t utime) {
  const auto after = log.rig_T_camera.lower_bound(utime);
  if (after == log.rig_T_camera.end()) return std::nullopt;
  SE3 rig_T_camera = after->second;
  if (after->first != utime) {
    if (after == log.rig_T_camera.begin()) return std::nullopt;
    const auto before = std::prev(after);
    const auto gap = static_cast<double>(after->first - before->first);
    if (gap > kMostPoseGap * 1e6) return std::nullopt;
    rig_T_camera = interpolate(before->second, after->second,
                               static_cast<double>(utime - before->first) / gap);
  }
  const SE3 rig_T_magnet = rig_T_camera * camera_T_magnet;
  return MagnetPose{rig_T_magnet.translation, rig_T_magnet.rotation * Eigen::Vector3d::UnitZ()};
}

// The log's readings of this shape, with currents where num_coils is not zero.
std::vector<CalibrationReading> make_readings(const CalibrationLog& log, int num_sensors,
                                              int num_axes, Eigen::Index num_coils,
                                              const RigConfiguration& rig, bool known_poses) {
  std::vector<CalibrationReading> readings;
  CurrentHistory history(rig.magnetic_localizer.max_current_gap);
  auto next_current = log.currents.begin();
  std::int64_t without_currents = 0;
  std::int64_t of_other_shape = 0;
  for (const auto& [utime, message] : log.readings) {
    if (message.num_sensors != num_sensors || message.num_axes != num_axes) {
      ++of_other_shape;
      continue;
    }
    CalibrationReading reading;
    reading.utime = utime;
    if (num_coils > 0) {
      while (next_current != log.currents.end() &&
             (!history.newest() || *history.newest() < utime)) {
        const std::vector<float>& current = next_current->second.current;
        if (static_cast<Eigen::Index>(current.size()) == num_coils) {
          history.add(next_current->first,
                      Eigen::Map<const Eigen::VectorXf>(current.data(), num_coils).cast<double>());
        }
        ++next_current;
      }
      const auto currents = history.at(utime);
      if (!currents) {
        ++without_currents;
        continue;
      }
      reading.currents = *currents;
    }
    reading.field.resize(num_sensors * num_axes);
    for (int s = 0; s < num_sensors; ++s) {
      const auto sensor = static_cast<std::size_t>(s);
      for (int axis = 0; axis < num_axes; ++axis) {
        const float value = message.field[sensor][static_cast<std::size_t>(axis)];
        const bool good = message.status[sensor] == hall_array_t::STATUS_OK &&
                          std::isfinite(value) && std::abs(value) < rig.hall_array.saturation;
        reading.field(s * num_axes + axis) = good ? value : 0;
        reading.usable.push_back(good);
      }
    }
    if (known_poses) {
      reading.known_pose = magnet_at(log, rig.camera_T_magnet.transform(), utime);
      if (!reading.known_pose) continue;
    }
    readings.push_back(std::move(reading));
  }
  if (of_other_shape > 0) {
    spdlog::warn("{} readings are not of {} sensors with {} axes and were left out", of_other_shape,
                 num_sensors, num_axes);
  }
  if (without_currents > 0) {
    spdlog::warn("{} readings have no coil currents within {} s and were left out",
                 without_currents, rig.magnetic_localizer.max_current_gap);
  }
  return readings;
}

void write_fragment(const std::string& path, const std::string& text) {
  write_whole(path, [&text](std::ofstream& file) { file << text; });
  spdlog::info("wrote {}", path);
}

int calibrate_coils_of(const Options& options) {
  const CalibrationLog log = read_log(options.log);
  if (log.currents.empty()) {
    throw CalibrationRefused(options.log + " has no currents on " + channel::kCoilCurrents);
  }
  const std::optional<RigConfiguration> configured = effective_rig(log, options);
  const hall_array_t& first = log.readings.begin()->second;
  std::optional<RigConfiguration> rig = configured;
  if (rig) rig->coils.tesla_per_ampere.resize(0, 0);
  if (rig && (rig->hall_array.num_sensors() != first.num_sensors ||
              rig->hall_array.num_axes != first.num_axes)) {
    throw ConfigurationError(
        fmt::format("the configuration has {} sensors with {} axes, the log {} with {}",
                    rig->hall_array.num_sensors(), rig->hall_array.num_axes, first.num_sensors,
                    first.num_axes));
  }
  const auto num_coils = static_cast<Eigen::Index>(log.currents.begin()->second.num_coils);
  Eigen::MatrixXd samples(static_cast<Eigen::Index>(log.currents.size()), num_coils);
  Eigen::Index row = 0;
  for (const auto& [utime, message] : log.currents) {
    if (message.num_coils != num_coils) continue;
    samples.row(row++) =
        Eigen::Map<const Eigen::RowVectorXf>(message.current.data(), num_coils).cast<double>();
  }
  const auto readings = make_readings(log, first.num_sensors, first.num_axes, num_coils,
                                      rig.value_or(RigConfiguration()), /*known_poses=*/false);
  const CoilCalibration calibration =
      calibrate_coils(readings, first.num_axes, measure_current_noise(samples.topRows(row)), rig);
  write_fragment(
      options.out,
      coil_fragment(calibration, rig, std::filesystem::path(options.log).filename().string()));
  std::fputs(coil_table(calibration).c_str(), stdout);
  return kExitDone;
}

int calibrate_array_of(const Options& options) {
  const CalibrationLog log = read_log(options.log);
  const std::optional<RigConfiguration> rig = effective_rig(log, options);
  if (!rig) {
    throw ConfigurationError(options.log + " has no " + channel::kRigConfig +
                             ": give the rig's configuration with --config");
  }
  const bool known =
      options.poses == "known" || (options.poses == "auto" && !log.rig_T_camera.empty());
  if (known && log.rig_T_camera.empty()) {
    throw CalibrationRefused(options.log + " has no poses on " + channel::kGroundTruthPose +
                             ": use --poses unknown");
  }
  spdlog::info("the magnet's poses are taken as {}",
               known ? std::string("known (") + channel::kGroundTruthPose + ")" : "unknown");
  const auto readings = make_readings(log, rig->hall_array.num_sensors(), rig->hall_array.num_axes,
                                      rig->coils.tesla_per_ampere.cols(), *rig, known);
  ArrayCalibrationOptions array = options.array;
  const auto prior = [](const std::optional<double>& given, double configured, double usual) {
    return given.value_or(std::max(configured, usual));
  };
  array.priors.gain_std = prior(options.gain_std, rig->hall_array.gain_std, array.priors.gain_std);
  array.priors.alignment_std =
      prior(options.alignment_std, rig->hall_array.alignment_std, array.priors.alignment_std);
  array.priors.offset_std =
      prior(options.offset_std, rig->hall_array.offset_std, array.priors.offset_std);
  Progress progress("calibrating the array");
  const ArrayCalibration calibration = calibrate_array(*rig, readings, array, [&](double fraction) {
    if (stop_requested()) throw std::runtime_error("stopped");
    progress.update(fraction);
  });
  write_fragment(
      options.out,
      array_fragment(calibration, *rig, std::filesystem::path(options.log).filename().string()));
  std::fputs(array_table(calibration, *rig).c_str(), stdout);
  return kExitDone;
}

int calibrate_light_of(const Options& options) {
  LightCommand light = options.light;
  light.log = options.log;
  light.configuration_files = options.configuration_files;
  light.settings = options.settings;
  const LightCalibrationTexts texts = run_light_calibration(light);
  write_fragment(options.out, texts.fragment);
  std::fputs(texts.table.c_str(), stdout);
  return kExitDone;
}

int calibrate_hand_eye_of(const Options& options) {
  const HandEyeTexts texts =
      run_hand_eye_calibration({options.log, options.configuration_files, options.settings});
  write_fragment(options.out, texts.fragment);
  std::fputs(texts.table.c_str(), stdout);
  return kExitDone;
}

void add_common_options(CLI::App& command, Options& options, const char* log) {
  command.add_option("LOG", options.log, log)->required()->check(CLI::ExistingFile);
  command.add_option("--out", options.out, "the configuration fragment to write")->required();
  add_configuration_options(command, options.configuration_files, options.settings);
}

}  // namespace

int run_calibrate(int argc, char** argv) {
  CLI::App app("Calibrates the rig from a log and writes a fragment of its configuration.",
               "calibrate");
  app.require_subcommand(1);
  Options options;
  CLI::App* coils = app.add_subcommand(
      "coils", "current-to-field matrix and sensor offsets from a log without the capsule");
  constexpr const char* kMagneticLog = "log with HALL_ARRAY, COIL_CURRENTS and RIG_CONFIG";
  add_common_options(*coils, options, kMagneticLog);
  coils->footer(
      "Drive each coil by itself, or all with independent currents, the capsule away.\n"
      "Example: calibrate coils empty.lcmlog --out coils.yaml");
  CLI::App* array = app.add_subcommand(
      "array",
      "gain, alignment and offset of each sensor, and the magnet's moment, from a log in "
      "which the magnet moves");
  add_common_options(*array, options, kMagneticLog);
  array
      ->add_option("--poses", options.poses,
                   "known: from GROUND_TRUTH_POSE and camera_T_magnet; unknown: estimated along; "
                   "auto: known where the log has them")
      ->check(CLI::IsMember({"auto", "known", "unknown"}))
      ->capture_default_str();
  array->add_option("--readings", options.array.most_readings, "readings used, evenly from the log")
      ->check(CLI::Range(50, 5000))
      ->capture_default_str();
  array
      ->add_option("--gain-std", options.gain_std,
                   "one sigma of relative gain errors; by default as configured, at least 0.01")
      ->check(CLI::PositiveNumber);
  array
      ->add_option("--alignment-std", options.alignment_std,
                   "of misalignments, radians; by default as configured, at least 0.0175")
      ->check(CLI::PositiveNumber);
  array
      ->add_option("--offset-std", options.offset_std,
                   "of offsets, tesla; by default as configured, at least 5e-6")
      ->check(CLI::PositiveNumber);
  array
      ->add_option("--position-std", options.array.priors.known_position_std,
                   "error of known poses, metres")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  array
      ->add_option("--axis-std", options.array.priors.known_axis_std,
                   "error of known poses, radians")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  array->footer(
      "Move the magnet under the whole array and turn it every way.\n"
      "Example: calibrate array sweep.lcmlog --config rig.yaml --config coils.yaml --out "
      "array.yaml");
  CLI::App* light = app.add_subcommand(
      "light",
      "power, lobe and vignetting of the capsule's light and the camera's response, from pictures "
      "of a flat card or of tissue with known depth");
  add_common_options(*light, options, "log with CAMERA, RIG_CONFIG and poses or depth");
  add_light_options(*light, options.light);
  CLI::App* hand_eye = app.add_subcommand("hand-eye",
                                          "the magnet's centre and axis in the camera's frame and "
                                          "the clocks' offset, from a derived log "
                                          "of motions");
  add_common_options(*hand_eye, options, "log with MAGNETIC_POSE, VISUAL_POSE and RIG_CONFIG");
  describe_hand_eye(*hand_eye);
  return run_command_line(app, argc, argv, [&] {
    if (hand_eye->parsed()) return calibrate_hand_eye_of(options);
    if (light->parsed()) return calibrate_light_of(options);
    return coils->parsed() ? calibrate_coils_of(options) : calibrate_array_of(options);
  });
}

}  // namespace gastronaut

#include "calibrate/light_calibration_process.hpp"

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <set>

#include "bus/log_file.hpp"
#include "calibrate/light_report.hpp"
#include "gastronaut/depth_image_t.hpp"
#include "gastronaut/image_t.hpp"
#include "gastronaut/magnetic_pose_t.hpp"
#include "gastronaut/rig_config_t.hpp"
#include "gastronaut/rigid_transform_t.hpp"
#include "pictures/depth_counts.hpp"
#include "process/channels.hpp"
#include "process/command_line.hpp"
#include "process/progress.hpp"

namespace gastronaut {
namespace {

constexpr double kMostPoseGap = 0.2;   // seconds between poses that are still bridged
constexpr double kCardAlbedo = 0.9;    // of white matte card
constexpr double kTissueAlbedo = 0.8;  // of stomach, red, vessels left out
constexpr int kFewestKnots = 17;       // straight lines between fewer leave a power law too far
constexpr int kMostKnots = 129;

enum class Geometry { kDepth, kPoses, kMagnetic };

// What a first look at the log finds.
struct LightLog {
  std::set<std::int64_t> pictures;  // utimes
  std::set<std::int64_t> depths;
  std::map<std::int64_t, SE3> rig_T_camera;
  std::map<std::int64_t, magnetic_pose_t> magnet;
  std::optional<std::string> rig_yaml;
  std::int64_t bad = 0;
};

template <class Message, class Use>
void decode(const LogReader::Event& event, std::int64_t& bad, const Use& use) {
  Message message;
  if (decode_message(event.payload, message) == DecodeResult::kOk) {
    use(message);
  } else {
    ++bad;
  }
}

template <class Use>
void for_each_event(const std::string& path, const std::string& what, const Use& use) {
  LogReader reader(path);
  Progress progress(what + " " + path);
  while (const auto event = reader.next()) {
    progress.update(static_cast<double>(reader.offset()) / static_cast<double>(reader.size()));
    if (stop_requested()) throw std::runtime_error("stopped");
    use(*event);
  }
  if (!reader.damage().empty()) spdlog::warn("{}: {}", path, reader.damage());
}

bool is_finite(const magnetic_pose_t& pose) {
  const Eigen::Map<const Matrix5d> covariance(pose.covariance[0]);
  return Eigen::Vector3d(pose.position).allFinite() && Eigen::Vector3d(pose.axis).allFinite() &&
         covariance.allFinite();
}

LightLog survey(const std::string& path) {
  LightLog log;
  for_each_event(path, "reading", [&log](const LogReader::Event& event) {
    if (event.channel == channel::kCamera) {
      decode<image_t>(event, log.bad, [&](const auto& m) { log.pictures.insert(m.utime); });
    } else if (event.channel == channel::kGroundTruthDepth) {
      decode<depth_image_t>(event, log.bad, [&](const auto& m) { log.depths.insert(m.utime); });
    } else if (event.channel == channel::kGroundTruthPose) {
      decode<rigid_transform_t>(event, log.bad, [&](const auto& m) {
        const Eigen::Quaterniond rotation(m.quat[0], m.quat[1], m.quat[2], m.quat[3]);
        const Eigen::Vector3d translation(m.trans);
        if (rotation.norm() > 0 && rotation.coeffs().allFinite() && translation.allFinite()) {
          log.rig_T_camera[m.utime] = {rotation.normalized(), translation};
        } else {
          ++log.bad;
        }
      });
    } else if (event.channel == channel::kMagneticPose) {
      decode<magnetic_pose_t>(event, log.bad, [&](const auto& m) {
        if (m.status == magnetic_pose_t::STATUS_OK && is_finite(m)) log.magnet[m.utime] = m;
      });
    } else if (event.channel == channel::kRigConfig) {
      decode<rig_config_t>(event, log.bad, [&](const auto& m) { log.rig_yaml = m.yaml; });
    }
  });
  if (log.bad > 0) spdlog::warn("{}: {} corrupt or foreign messages left out", path, log.bad);
  return log;
}

Geometry choose_geometry(const LightLog& log, const LightCommand& options) {
  const auto need = [&](bool there, const char* channel, const char* advice) {
    if (there) return;
    throw CalibrationRefused(fmt::format("{} has nothing on {}: {}", options.log, channel, advice));
  };
  if (options.geometry == "depth") {
    need(!log.depths.empty(), channel::kGroundTruthDepth, "use --geometry poses with a flat card");
    return Geometry::kDepth;
  }
  if (options.geometry == "poses") {
    need(!log.rig_T_camera.empty(), channel::kGroundTruthPose, "use --geometry magnetic");
    return Geometry::kPoses;
  }
  if (options.geometry == "auto" && !log.depths.empty()) return Geometry::kDepth;
  if (options.geometry == "auto" && !log.rig_T_camera.empty()) return Geometry::kPoses;
  need(!log.magnet.empty(), channel::kMagneticPose,
       "where the camera was must be known. Localise the magnet first: replay RAW --only "
       "magnetic_localizer --keep-images --out DERIVED, and calibrate from DERIVED");
  return Geometry::kMagnetic;
}

// The entries around `utime`, if they are near enough, and where between them it lies.
template <class Value>
struct Bracket {
  const Value* before;
  const Value* after;
  double fraction;
};
template <class Value>
std::optional<Bracket<Value>> bracket(const std::map<std::int64_t, Value>& track,
                                      std::int64_t utime) {
  const auto after = track.lower_bound(utime);
  if (after == track.end()) return std::nullopt;
  if (after->first == utime) return Bracket<Value>{&after->second, &after->second, 0};
  if (after == track.begin()) return std::nullopt;
  const auto before = std::prev(after);
  const auto gap = static_cast<double>(after->first - before->first);
  if (gap > kMostPoseGap * 1e6) return std::nullopt;
  return Bracket<Value>{&before->second, &after->second,
                        static_cast<double>(utime - before->first) / gap};
}

std::optional<CameraPosePrior> pose_at(const LightLog& log, Geometry geometry,
                                       const RigConfiguration& rig, const LightCommand& options,
                                       std::int64_t utime) {
  if (geometry == Geometry::kPoses) {
    const auto at = bracket(log.rig_T_camera, utime);
    if (!at) return std::nullopt;
    CameraPosePrior prior;
    prior.rig_T_camera = interpolate(*at->before, *at->after, at->fraction);
    prior.information.setZero();
    prior.information.diagonal().head<3>().setConstant(std::pow(options.position_std, -2));
    prior.information.diagonal().tail<3>().setConstant(std::pow(options.angle_std, -2));
    return prior;
  }
  const auto at = bracket(log.magnet, utime);
  if (!at) return std::nullopt;
  const auto between = [&](const double* before, const double* after) -> Eigen::Vector3d {
    return (1 - at->fraction) * Eigen::Vector3d(before) + at->fraction * Eigen::Vector3d(after);
  };
  const magnetic_pose_t& nearer = at->fraction < 0.5 ? *at->before : *at->after;
  return pose_from_magnet(
      between(at->before->position, at->after->position),
      between(at->before->axis, at->after->axis).normalized(),
      Eigen::Map<const Eigen::Matrix<double, 5, 5, Eigen::RowMajor>>(nearer.covariance[0]),
      rig.camera_T_magnet.transform(), options.position_std, options.angle_std);
}

double gain_of(const image_t& message) {
  for (const image_metadata_t& entry : message.metadata) {
    if (entry.key != "gain") continue;
    const double gain =
        std::strtod(std::string(entry.value.begin(), entry.value.end()).c_str(), nullptr);
    if (std::isfinite(gain) && gain > 0) return gain;
  }
  return 1;
}

using Picture = std::array<Plane<std::uint8_t>, 3>;  // red, green, blue

// Nothing for what is not a good JPEG of this size.
std::optional<Picture> decode_picture(const image_t& message, const CameraConfiguration& camera) {
  if (message.pixelformat != image_t::PIXEL_FORMAT_MJPEG || message.data.empty()) {
    return std::nullopt;
  }
  cv::Mat decoded;
  try {
    decoded = cv::imdecode(message.data, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);
  } catch (const cv::Exception&) {
    return std::nullopt;
  }
  if (decoded.cols != camera.width || decoded.rows != camera.height) return std::nullopt;
  Picture picture;
  for (std::size_t channel = 0; channel < picture.size(); ++channel) {
    picture[channel] = Plane<std::uint8_t>(camera.width, camera.height);
    for (int row = 0; row < camera.height; ++row) {
      const auto* from = decoded.ptr<std::uint8_t>(row);
      for (int col = 0; col < camera.width; ++col) {
        picture[channel].at(col, row) = from[3 * col + 2 - static_cast<int>(channel)];
      }
    }
  }
  return picture;
}

std::optional<DepthMap> decode_depth(const depth_image_t& message) {
  const std::optional<DepthEncoding> encoding = depth_encoding(message.encoding);
  if (!encoding || !(message.fx > 0) || !(message.fy > 0)) return std::nullopt;
  const auto counts = decode_depth_counts(*encoding, message.data, message.width, message.height);
  if (!counts) return std::nullopt;
  DepthMap map{Plane<float>(message.width, message.height), message.fx, message.fy, message.cx,
               message.cy};
  std::transform(
      counts->begin(), counts->end(), map.depth.values.begin(),
      [&](std::uint16_t count) { return static_cast<float>(count * message.metres_per_count); });
  return map;
}

// Evenly chosen of those whose geometry is known.
std::set<std::int64_t> choose_pictures(const LightLog& log, Geometry geometry,
                                       const RigConfiguration& rig, const LightCommand& options) {
  std::vector<std::int64_t> usable;
  for (const std::int64_t utime : log.pictures) {
    const bool known = geometry == Geometry::kDepth
                           ? log.depths.contains(utime)
                           : pose_at(log, geometry, rig, options, utime).has_value();
    if (known) usable.push_back(utime);
  }
  std::set<std::int64_t> chosen;
  const auto most = std::min(usable.size(), static_cast<std::size_t>(options.most_pictures));
  for (std::size_t i = 0; i < most; ++i) chosen.insert(usable[i * usable.size() / most]);
  return chosen;
}

// Takes the samples of the chosen pictures; a picture waits for its depth or the other way round.
std::vector<LightPicture> read_pictures(const LightLog& log, Geometry geometry,
                                        const RigConfiguration& rig, const LightCommand& options,
                                        SampleCounts& counts) {
  const std::set<std::int64_t> chosen = choose_pictures(log, geometry, rig, options);
  const CameraModel camera(rig.camera.intrinsics());
  struct Waiting {
    double gain;
    Picture picture;
  };
  std::map<std::int64_t, Waiting> waiting;
  std::map<std::int64_t, DepthMap> depths;
  std::map<std::int64_t, LightPicture> taken;
  std::int64_t unreadable = 0;
  const auto take = [&](std::int64_t utime, const Waiting& frame,
                        const std::optional<DepthMap>& depth) {
    LightPicture& picture = taken[utime];
    picture.exposure = rig.camera.exposure_gain * frame.gain;
    picture.samples = take_samples(frame.picture, camera, depth, counts);
    if (!depth) picture.pose = pose_at(log, geometry, rig, options, utime);
  };
  const auto join = [&](std::int64_t utime) {
    const auto frame = waiting.find(utime);
    const auto depth = depths.find(utime);
    if (frame == waiting.end() || depth == depths.end()) return;
    take(utime, frame->second, depth->second);
    waiting.erase(frame);
    depths.erase(depth);
  };
  for_each_event(options.log, "looking at the pictures of", [&](const LogReader::Event& event) {
    std::int64_t known_bad = 0;  // counted by the survey
    if (event.channel == channel::kCamera) {
      decode<image_t>(event, known_bad, [&](const image_t& message) {
        if (!chosen.contains(message.utime)) return;
        auto picture = decode_picture(message, rig.camera);
        if (!picture) {
          ++unreadable;
          return;
        }
        Waiting frame{gain_of(message), std::move(*picture)};
        if (geometry != Geometry::kDepth) {
          take(message.utime, frame, std::nullopt);
          return;
        }
        waiting.insert_or_assign(message.utime, std::move(frame));
        join(message.utime);
      });
    } else if (event.channel == channel::kGroundTruthDepth && geometry == Geometry::kDepth) {
      decode<depth_image_t>(event, known_bad, [&](const depth_image_t& message) {
        if (!chosen.contains(message.utime)) return;
        auto depth = decode_depth(message);
        if (!depth) {
          ++unreadable;
          return;
        }
        depths.insert_or_assign(message.utime, std::move(*depth));
        join(message.utime);
      });
    }
  });
  if (unreadable > 0) {
    spdlog::warn("{} of {} pictures cannot be read, or are not {} x {} as the configuration says",
                 unreadable, chosen.size(), rig.camera.width, rig.camera.height);
  }
  std::vector<LightPicture> pictures;
  std::vector<std::optional<SE3>> poses;
  for (auto& [utime, picture] : taken) {
    pictures.push_back(std::move(picture));
    const auto at = bracket(log.rig_T_camera, utime);
    poses.emplace_back();
    if (at) poses.back() = interpolate(*at->before, *at->after, at->fraction);
  }
  if (geometry == Geometry::kDepth) number_places(poses, pictures);
  return pictures;
}

}  // namespace

void add_light_options(CLI::App& command, LightCommand& options) {
  command
      .add_option("--geometry", options.geometry,
                  "depth: tissue (or a card), from GROUND_TRUTH_DEPTH; poses: a flat matte card, "
                  "from GROUND_TRUTH_POSE; magnetic: the same, from MAGNETIC_POSE and "
                  "camera_T_magnet; auto: the first of these that the log has")
      ->check(CLI::IsMember({"auto", "depth", "poses", "magnetic"}))
      ->capture_default_str();
  command
      .add_option("--albedo", options.albedo,
                  fmt::format("red albedo of the card, by default {:g}, or of the tissue on "
                              "average, {:g}: only its product with the power can be measured",
                              kCardAlbedo, kTissueAlbedo))
      ->check(CLI::Range(0.01, 1.0));
  command
      .add_option("--response", options.response_knots,
                  "measure the response as a table of so many levels instead of gamma")
      ->check(CLI::Range(kFewestKnots, kMostKnots));
  command
      .add_option("--hold", options.held,
                  "leave as configured: lobe, vignetting, response (may be given several times)")
      ->check(CLI::IsMember({"lobe", "vignetting", "response"}))
      ->allow_extra_args(false);
  command.add_option("--pictures", options.most_pictures, "pictures used, evenly from the log")
      ->check(CLI::Range(5, 2000))
      ->capture_default_str();
  command
      .add_option("--position-std", options.position_std,
                  "error of the poses, metres; of magnetic ones beside their covariance")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command.add_option("--angle-std", options.angle_std, "the same in radians")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command.footer(
      "In the dark, look at a white matte card from 8 to 50 mm, square on and tilted, so that it\n"
      "fills the picture; nothing saturated.\n"
      "Example: calibrate light card.lcmlog --albedo 0.88 --out light.yaml");
}

LightCalibrationTexts run_light_calibration(const LightCommand& options) {
  const LightLog log = survey(options.log);
  if (log.pictures.empty()) {
    throw CalibrationRefused(
        fmt::format("{} has no pictures on {} (replay leaves them out without --keep-images)",
                    options.log, channel::kCamera));
  }
  std::vector<YamlSource> sources;
  if (log.rig_yaml) {
    sources.push_back(parse_yaml(*log.rig_yaml, options.log + " " + channel::kRigConfig));
  }
  for (const std::string& file : options.configuration_files) {
    sources.push_back(load_yaml_file(file));
  }
  if (sources.empty()) {
    throw ConfigurationError(options.log + " has no " + channel::kRigConfig +
                             ": give the rig's configuration with --config");
  }
  RigConfiguration rig;
  read_configuration(rig, sources, options.settings);

  const Geometry geometry = choose_geometry(log, options);
  spdlog::info("{}", geometry == Geometry::kDepth ? "the wall's depth is known (GROUND_TRUTH_DEPTH)"
                     : geometry == Geometry::kPoses ? "a flat card seen from known poses "
                                                      "(GROUND_TRUTH_POSE)"
                                                    : "a flat card seen from magnetic poses "
                                                      "(MAGNETIC_POSE)");
  SampleCounts counts;
  const std::vector<LightPicture> pictures = read_pictures(log, geometry, rig, options, counts);
  LightCalibrationOptions light;
  light.albedo =
      options.albedo.value_or(geometry == Geometry::kDepth ? kTissueAlbedo : kCardAlbedo);
  light.response_knots = options.response_knots;
  for (const std::string& held : options.held) {
    light.hold_lobe |= held == "lobe";
    light.hold_vignetting |= held == "vignetting";
    light.hold_response |= held == "response";
  }
  Progress progress("calibrating the light");
  const LightCalibration calibration =
      calibrate_light(rig, pictures, counts, light, [&](double fraction) {
        if (stop_requested()) throw std::runtime_error("stopped");
        progress.update(fraction);
      });
  for (const std::string& weakness : calibration.weaknesses) spdlog::warn("{}", weakness);
  return {light_fragment(calibration, rig, light,
                         std::filesystem::path(options.log).filename().string()),
          light_table(calibration, rig, light)};
}

}  // namespace gastronaut

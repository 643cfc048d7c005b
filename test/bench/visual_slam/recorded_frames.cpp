#include "bench/visual_slam/recorded_frames.hpp"

#include <algorithm>
#include <gastronaut/depth_image_t.hpp>
#include <gastronaut/image_t.hpp>
#include <gastronaut/rig_config_t.hpp>
#include <gastronaut/rigid_transform_t.hpp>
#include <map>
#include <stdexcept>
#include <utility>

#include "bus/log_file.hpp"
#include "bus/wire.hpp"
#include "evaluate/pictures.hpp"
#include "evaluate/trajectory.hpp"
#include "pictures/depth_counts.hpp"
#include "process/channels.hpp"
#include "process/progress.hpp"

namespace gastronaut::slam {
namespace {

struct Messages {
  std::optional<depth_image_t> depth;
  std::optional<image_t> albedo;
  std::optional<image_t> camera;
};

struct RawRecording {
  std::map<std::int64_t, Messages> by_utime;
  std::string configuration;  // YAML
  evaluation::TruthTrack truth;
};

template <class Message>
std::optional<Message> decoded(const LogReader::Event& event) {
  Message message;
  if (decode_message(event.payload, message) != DecodeResult::kOk) return std::nullopt;
  return message;
}

RawRecording read_messages(const std::string& log, DepthChannel depth) {
  const std::string depth_channel =
      depth == DepthChannel::kOwn ? channel::kDepth : channel::kGroundTruthDepth;
  RawRecording raw;
  LogReader reader(log);
  Progress progress("reading " + log);
  while (const auto event = reader.next()) {
    if (event->channel == depth_channel) {
      if (auto message = decoded<depth_image_t>(*event)) {
        raw.by_utime[message->utime].depth = std::move(message);
      }
    } else if (event->channel == channel::kAlbedo) {
      if (auto message = decoded<image_t>(*event)) {
        raw.by_utime[message->utime].albedo = std::move(message);
      }
    } else if (event->channel == channel::kCamera) {
      if (auto message = decoded<image_t>(*event)) {
        raw.by_utime[message->utime].camera = std::move(message);
      }
    } else if (event->channel == channel::kRigConfig && raw.configuration.empty()) {
      if (const auto message = decoded<rig_config_t>(*event)) raw.configuration = message->yaml;
    } else if (event->channel == channel::kGroundTruthPose) {
      if (const auto message = decoded<rigid_transform_t>(*event)) {
        const double* q = message->quat;
        raw.truth.add(message->utime, {Eigen::Quaterniond(q[0], q[1], q[2], q[3]).normalized(),
                                       {message->trans[0], message->trans[1], message->trans[2]}});
      }
    }
    progress.update(static_cast<double>(reader.offset()) / static_cast<double>(reader.size()));
  }
  return raw;
}

std::optional<DepthCounts> depth_counts(const depth_image_t& message) {
  const auto encoding = depth_encoding(message.encoding);
  if (!encoding) return std::nullopt;
  auto counts = decode_depth_counts(*encoding, message.data, message.width, message.height);
  if (!counts) return std::nullopt;
  return DepthCounts{
      {message.width, message.height, message.fx, message.fy, message.cx, message.cy},
      std::move(*counts),
      message.metres_per_count,
      message.relative_std};
}

// The grid of a picture that depth of `coarse` was made from, depth's own where it was not.
PinholeGrid picture_grid(const PinholeGrid& coarse, int width, int height) {
  const evaluation::DepthPicture depth{coarse.width, coarse.height, coarse.fx, coarse.fy,
                                       coarse.cx,    coarse.cy,     {},        0};
  return evaluation::finer_grid(depth, width, height).value_or(coarse);
}

std::optional<AlbedoLevels> albedo_levels(const image_t& message, const PinholeGrid& depth) {
  auto levels =
      evaluation::decode_levels(message.data, message.width, message.height, message.row_stride);
  const PinholeGrid grid = picture_grid(depth, message.width, message.height);
  if (!levels || !levels->same_size(grid.width, grid.height)) return std::nullopt;
  return AlbedoLevels{grid, std::move(levels->values)};
}

class LuminanceReader {
 public:
  explicit LuminanceReader(const CameraConfiguration& camera) : camera_(camera) {}

  std::optional<AlbedoLevels> read(const image_t& message, const PinholeGrid& depth) {
    if (message.pixelformat != image_t::PIXEL_FORMAT_MJPEG) return std::nullopt;
    const auto picture = evaluation::decode_colour(evaluation::PictureEncoding::kJpeg, message.data,
                                                   message.width, message.height, 0);
    if (!picture || !picture->same_size(camera_.width, camera_.height)) return std::nullopt;
    const PinholeGrid grid = picture_grid(depth, message.width, message.height);
    if (!undistorter_ || undistorter_->grid() != grid) {
      undistorter_.emplace(camera_.intrinsics(), grid);
    }
    return AlbedoLevels{grid, evaluation::luminance(undistorter_->undistort(*picture)).values};
  }

 private:
  CameraConfiguration camera_;
  std::optional<evaluation::Undistorter> undistorter_;
};

PictureHealth health_of(const image_t& albedo) {
  PictureHealth health;
  for (const image_metadata_t& entry : albedo.metadata) {
    const std::string value(entry.value.begin(), entry.value.end());
    if (entry.key == "failure") health.failure = value;
    if (entry.key == "failure_message") health.failure_message = value;
    if (entry.key == "sharpness") health.sharpness = std::stod(value);
  }
  return health;
}

}  // namespace

Recording read_recording(const RecordingOptions& options) {
  RawRecording raw = read_messages(options.log, options.depth);
  Recording recording{parse_rig_configuration(raw.configuration, options.log + " (RIG_CONFIG)",
                                              options.settings, options.configuration_files),
                      {},
                      true,
                      true};
  LuminanceReader luminance(recording.configuration.camera);
  std::size_t with_truth = 0;
  std::size_t done = 0;
  Progress progress("decoding the pictures");
  for (auto& [utime, messages] : raw.by_utime) {
    progress.update(static_cast<double>(++done) / static_cast<double>(raw.by_utime.size()));
    if (!messages.depth) continue;
    auto depth = depth_counts(*messages.depth);
    if (!depth) continue;
    if (options.depth == DepthChannel::kTruth) depth->relative_std = options.truth_relative_std;
    RecordedFrame frame;
    frame.utime = utime;
    if (messages.albedo) {
      frame.albedo = albedo_levels(*messages.albedo, depth->grid);
      frame.health = health_of(*messages.albedo);
    }
    if (messages.camera) frame.luminance = luminance.read(*messages.camera, depth->grid);
    messages = {};
    if (!frame.albedo && !frame.luminance) continue;
    frame.depth = std::move(*depth);
    frame.rig_T_camera = raw.truth.at(utime);
    with_truth += frame.rig_T_camera ? 1 : 0;
    recording.has_albedo &= frame.albedo.has_value();
    recording.has_luminance &= frame.luminance.has_value();
    recording.frames.push_back(std::move(frame));
  }
  if (recording.frames.empty()) {
    throw std::runtime_error(options.log +
                             " has no frame with depth and a picture; make a log that does with: "
                             "replay RAW --out DERIVED --keep-images");
  }
  if (with_truth == 0) {
    throw std::runtime_error(options.log + " has no GROUND_TRUTH_POSE of any frame");
  }
  if (!recording.has_albedo && !recording.has_luminance) {
    throw std::runtime_error(options.log + ": some frames have ALBEDO and others only CAMERA");
  }
  return recording;
}

}  // namespace gastronaut::slam

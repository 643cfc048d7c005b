#include "import/import_process.hpp"

#include <zstd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <span>
#include <stdexcept>

#include "bus/log_file.hpp"
#include "import/depth_geometry.hpp"
#include "process/channels.hpp"
#include "process/command_line.hpp"
#include "process/progress.hpp"
#include "process/rig_config_message.hpp"

namespace gastronaut {
namespace {

constexpr std::int64_t kConfigurationInterval = 10'000'000;  // microseconds
constexpr std::int64_t kNever = std::numeric_limits<std::int64_t>::max();

image_t make_image(const Frame& frame, const CameraConfiguration& camera) {
  image_t image{};
  image.utime = frame.utime;
  image.width = camera.width;
  image.height = camera.height;
  image.pixelformat = image_t::PIXEL_FORMAT_MJPEG;
  image.data = frame.jpeg;
  image.size = static_cast<std::int32_t>(image.data.size());
  image_metadata_t seq;
  seq.key = "seq";
  const std::string number = std::to_string(frame.seq);
  seq.value.assign(number.begin(), number.end());
  seq.n = static_cast<std::int32_t>(seq.value.size());
  image.metadata = {seq};
  image.nmetadata = 1;
  return image;
}

std::vector<std::uint8_t> compress(const std::vector<std::uint16_t>& counts) {
  static_assert(std::endian::native == std::endian::little, "depth_image_t is little-endian");
  constexpr int kLevel = 3;
  const std::size_t bytes = counts.size() * sizeof(counts[0]);
  std::vector<std::uint8_t> data(ZSTD_compressBound(bytes));
  const std::size_t size = ZSTD_compress(data.data(), data.size(), counts.data(), bytes, kLevel);
  if (ZSTD_isError(size) != 0) {
    throw std::runtime_error(std::string("depth cannot be compressed: ") + ZSTD_getErrorName(size));
  }
  data.resize(size);
  return data;
}

depth_image_t make_depth(const Frame& frame, const Recording& recording,
                         const DepthUndistorter& undistorter) {
  const CameraConfiguration& camera = recording.rig.camera;
  depth_image_t depth{};
  depth.utime = frame.utime;
  depth.width = camera.width;
  depth.height = camera.height;
  depth.fx = camera.fx;
  depth.fy = camera.fy;
  depth.cx = camera.cx;
  depth.cy = camera.cy;
  depth.metres_per_count = camera.metres_per_depth_count;
  depth.relative_std = recording.depth_relative_std;
  depth.encoding = depth_image_t::ENCODING_ZSTD;
  depth.data = compress(undistorter.undistort(frame.depth));
  depth.size = static_cast<std::int32_t>(depth.data.size());
  return depth;
}

std::span<const float> reading(const Series& series, std::size_t index) {
  return std::span(series.values).subspan(index * series.width, series.width);
}

hall_array_t make_hall(const Series& series, std::size_t index,
                       const HallArrayConfiguration& array) {
  hall_array_t message{};
  message.utime = series.utimes[index];
  message.seq = series.seqs[index];
  message.num_axes = array.num_axes;
  message.num_sensors = array.num_sensors();
  const auto axes = static_cast<std::size_t>(array.num_axes);
  const auto values = reading(series, index);
  for (std::size_t first = 0; first < series.width; first += axes) {
    const auto sensor = values.subspan(first, axes);
    const bool saturated = std::ranges::any_of(
        sensor, [&](float field) { return std::abs(field) >= array.saturation; });
    message.field.emplace_back(sensor.begin(), sensor.end());
    message.status.push_back(saturated ? std::int32_t{hall_array_t::STATUS_SATURATED}
                                       : std::int32_t{hall_array_t::STATUS_OK});
  }
  return message;
}

coil_currents_t make_currents(const Series& series, std::size_t index) {
  coil_currents_t message{};
  message.utime = series.utimes[index];
  message.seq = series.seqs[index];
  message.num_coils = static_cast<std::int32_t>(series.width);
  const auto values = reading(series, index);
  message.current.assign(values.begin(), values.end());
  return message;
}

rigid_transform_t make_pose(const StampedPose& pose) {
  rigid_transform_t message{};
  message.utime = pose.utime;
  const Eigen::Vector3d& t = pose.rig_T_camera.translation;
  const Eigen::Quaterniond& q = pose.rig_T_camera.rotation;
  std::copy_n(t.data(), 3, message.trans);
  const double wxyz[] = {q.w(), q.x(), q.y(), q.z()};
  std::copy_n(wxyz, 4, message.quat);
  return message;
}

}  // namespace

ImportCounts write_recording(Recording recording, const std::string& path, Issues& issues) {
  LogWriter log(path);
  ImportCounts counts;
  const auto write = [&](const std::string& channel, const auto& message) {
    log.write(channel, message);
    ++counts[channel];
  };
  const DepthUndistorter undistorter(recording.rig.camera.intrinsics());
  const std::string depth_channel = recording.depth_kind == DepthKind::kGroundTruth
                                        ? channel::kGroundTruthDepth
                                        : channel::kDepth;
  rig_config_t configuration = rig_config_message(recording.rig, 0);

  // A merge of four sequences, each ascending by itself.
  Progress progress("frames");
  std::size_t frames_done = 0;
  std::optional<Frame> frame = recording.frames->next(issues);
  std::size_t currents = 0;
  std::size_t hall = 0;
  std::size_t pose = 0;
  std::optional<std::int64_t> configuration_due;
  while (true) {
    const auto time_of = [](const Series& series, std::size_t index) {
      return index < series.size() ? series.utimes[index] : kNever;
    };
    const std::int64_t currents_utime = time_of(recording.coil_currents, currents);
    const std::int64_t hall_utime = time_of(recording.hall, hall);
    const std::int64_t pose_utime =
        pose < recording.poses.size() ? recording.poses[pose].utime : kNever;
    const std::int64_t frame_utime = frame ? frame->utime : kNever;
    const std::int64_t utime = std::min({currents_utime, hall_utime, pose_utime, frame_utime});
    if (utime == kNever) break;
    if (stop_requested()) throw std::runtime_error("interrupted; " + path + " was not written");
    if (!configuration_due) configuration_due = utime;
    while (*configuration_due <= utime) {
      configuration.utime = *configuration_due;
      write(channel::kRigConfig, configuration);
      *configuration_due += kConfigurationInterval;
    }
    if (currents_utime == utime) {
      write(channel::kCoilCurrents, make_currents(recording.coil_currents, currents++));
    }
    if (hall_utime == utime) {
      write(channel::kHallArray, make_hall(recording.hall, hall++, recording.rig.hall_array));
    }
    if (pose_utime == utime) write(channel::kGroundTruthPose, make_pose(recording.poses[pose++]));
    if (frame_utime == utime) {
      if (!frame->jpeg.empty()) write(channel::kCamera, make_image(*frame, recording.rig.camera));
      if (!frame->depth.empty()) write(depth_channel, make_depth(*frame, recording, undistorter));
      frame = recording.frames->next(issues);
      progress.update(static_cast<double>(++frames_done) /
                      static_cast<double>(std::max<std::size_t>(recording.frames->count(), 1)));
    }
  }
  if (!counts.contains(channel::kCamera)) {
    throw std::runtime_error("no usable picture is left; nothing was imported");
  }
  log.close();
  return counts;
}

}  // namespace gastronaut

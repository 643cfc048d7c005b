#include "virtual_rig/virtual_rig_process.hpp"

#include <spdlog/fmt/fmt.h>
#include <zstd.h>

#include <array>
#include <atomic>
#include <cmath>
#include <gastronaut/coil_currents_t.hpp>
#include <gastronaut/depth_image_t.hpp>
#include <gastronaut/hall_array_t.hpp>
#include <gastronaut/image_t.hpp>
#include <gastronaut/rigid_transform_t.hpp>

#include "bus/wire.hpp"
#include "numerics/counter_random.hpp"
#include "process/channels.hpp"
#include "process/rig_config_message.hpp"
#include "process/whole_file.hpp"
#include "virtual_rig/camera_simulator.hpp"
#include "virtual_rig/magnetic_rig.hpp"
#include "virtual_rig/organ.hpp"
#include "virtual_rig/random_streams.hpp"
#include "virtual_rig/trajectory.hpp"

namespace gastronaut {
namespace {

static_assert(kSensorSaturated == hall_array_t::STATUS_SATURATED);
static_assert(kSensorStale == hall_array_t::STATUS_STALE);

constexpr double kConfigurationPeriod = 10;  // seconds between RIG_CONFIG

// Things that happen at a steady rate, in the order in which they come at equal times.
enum Source : std::size_t { kConfiguration, kCurrents, kHall, kCamera, kNumSources };

rigid_transform_t to_message(const SE3& transform, std::int64_t utime) {
  rigid_transform_t message{};
  message.utime = utime;
  Eigen::Vector3d::Map(message.trans) = transform.translation;
  const Eigen::Quaterniond& q = transform.rotation;
  Eigen::Vector4d::Map(message.quat) << q.w(), q.x(), q.y(), q.z();
  return message;
}

image_metadata_t metadata(const char* key, const std::string& value) {
  image_metadata_t entry;
  entry.key = key;
  entry.n = static_cast<std::int32_t>(value.size());
  entry.value.assign(value.begin(), value.end());
  return entry;
}

std::vector<std::uint8_t> compress_depth(const std::vector<std::uint16_t>& counts) {
  const std::size_t size = counts.size() * sizeof(counts[0]);
  std::vector<std::uint8_t> compressed(ZSTD_compressBound(size));
  constexpr int kFast = 1;
  const std::size_t written =
      ZSTD_compress(compressed.data(), compressed.size(), counts.data(), size, kFast);
  if (ZSTD_isError(written)) {
    throw std::runtime_error(std::string("zstd: ") + ZSTD_getErrorName(written));
  }
  compressed.resize(written);
  return compressed;
}

}  // namespace

struct VirtualRigProcess::Rig {
  VirtualRigScenario scenario;
  std::int64_t start_utime;
  Sink sink;
  Organ organ;
  Trajectory trajectory;
  MagneticRig magnetics;
  SE3 camera_T_magnet;
  std::optional<CameraSimulator> camera;
  std::array<std::int64_t, kNumSources> count{};
  std::int64_t sent = 0;
  std::function<bool(double)> skip;
  // Read by the thread that reports while another one makes messages.
  std::atomic<std::int64_t> pictures = 0;
  std::atomic<std::int64_t> pictures_skipped = 0;

  Rig(const VirtualRigScenario& wanted, std::int64_t start, Sink to)
      : scenario(wanted),
        start_utime(start),
        sink(std::move(to)),
        organ(wanted.organ),
        trajectory(wanted.trajectory, organ.centreline(), wanted.rig.camera_T_magnet.transform(),
                   wanted.seed),
        magnetics(wanted),
        camera_T_magnet(wanted.rig.camera_T_magnet.transform()) {
    if (wanted.imaging.enabled && trajectory.pose(0)) camera.emplace(wanted, organ, trajectory);
  }

  double time_of(std::size_t source) const {
    const auto n = static_cast<double>(count[source]);
    switch (source) {
      case kConfiguration:
        return n * kConfigurationPeriod;
      case kCurrents:
        return n / scenario.rig.hall_array.rate + scenario.magnetics.current_offset;
      case kHall:
        return n / scenario.rig.hall_array.rate;
      default:
        return n / scenario.rig.camera.rate;
    }
  }
  std::size_t next_source() const {
    std::size_t next = 0;
    for (std::size_t source = 1; source < kNumSources; ++source) {
      if (time_of(source) < time_of(next)) next = source;
    }
    return next;
  }
  std::int64_t utime(double time) const { return start_utime + std::llround(time * 1e6); }

  template <class Message>
  void send(const char* channel, const Message& message, double time) {
    const auto number = static_cast<std::uint64_t>(sent++);
    for (const FaultConfiguration& fault : scenario.faults) {
      if (fault.kind != FaultKind::kLostMessages || fault.channel != channel) continue;
      const CounterRandom random(scenario.seed, stream_id(RandomStream::kLostMessages));
      if (fault.active(time) && random.uniform(number) < fault.strength) return;
    }
    sink(channel, encode_message(message), message.utime);
  }

  void send_configuration(double time) {
    send(channel::kRigConfig, rig_config_message(magnetics.published_configuration(), utime(time)),
         time);
  }

  void send_currents(std::int64_t index, double time) {
    if (magnetics.num_coils() == 0) return;
    const Eigen::VectorXf currents = magnetics.measured_currents(index, time).cast<float>();
    coil_currents_t message;
    message.utime = utime(time);
    message.seq = static_cast<std::int32_t>(index);
    message.num_coils = static_cast<std::int32_t>(currents.size());
    message.current.assign(currents.begin(), currents.end());
    send(channel::kCoilCurrents, message, time);
  }

  void send_hall(std::int64_t index, double time) {
    std::optional<SE3> rig_T_magnet = trajectory.pose(time);
    if (rig_T_magnet) rig_T_magnet = *rig_T_magnet * camera_T_magnet;
    const HallReading reading = magnetics.read(index, time, rig_T_magnet);
    hall_array_t message;
    message.utime = utime(time);
    message.seq = static_cast<std::int32_t>(index);
    message.num_sensors = static_cast<std::int32_t>(reading.status.size());
    message.num_axes = scenario.rig.hall_array.num_axes;
    message.status = reading.status;
    message.field.resize(reading.status.size());
    Eigen::Index n = 0;
    for (std::vector<float>& sensor : message.field) {
      for (int axis = 0; axis < message.num_axes; ++axis) {
        sensor.push_back(static_cast<float>(reading.field[n++]));
      }
    }
    send(channel::kHallArray, message, time);
  }

  void send_frame(std::int64_t index, double time) {
    const std::optional<SE3> rig_T_camera = trajectory.pose(time);
    if (!rig_T_camera) return;
    send(channel::kGroundTruthPose, to_message(*rig_T_camera, utime(time)), time);
    if (!camera) return;
    if (skip && skip(time)) {
      ++pictures_skipped;
      return;
    }
    ++pictures;
    const CameraFrame frame = camera->take(index, time);
    const CameraConfiguration& configuration = scenario.rig.camera;
    image_t picture;
    picture.utime = utime(time);
    picture.width = configuration.width;
    picture.height = configuration.height;
    picture.row_stride = 0;
    picture.pixelformat = image_t::PIXEL_FORMAT_MJPEG;
    picture.size = static_cast<std::int32_t>(frame.jpeg.size());
    picture.data = frame.jpeg;
    const auto exposure = static_cast<std::int64_t>(std::llround(scenario.imaging.exposure * 1e6));
    picture.metadata = {metadata("seq", std::to_string(index)),
                        metadata("exposure_us", std::to_string(exposure)),
                        metadata("gain", fmt::format("{}", frame.gain))};
    picture.nmetadata = static_cast<std::int32_t>(picture.metadata.size());
    send(channel::kCamera, picture, time);

    depth_image_t depth;
    depth.utime = utime(time);
    depth.width = configuration.width;
    depth.height = configuration.height;
    depth.fx = configuration.fx;
    depth.fy = configuration.fy;
    depth.cx = configuration.cx;
    depth.cy = configuration.cy;
    depth.metres_per_count = configuration.metres_per_depth_count;
    depth.relative_std = 0;
    depth.encoding = depth_image_t::ENCODING_ZSTD;
    depth.data = compress_depth(frame.depth);
    depth.size = static_cast<std::int32_t>(depth.data.size());
    send(channel::kGroundTruthDepth, depth, time);
  }
};

VirtualRigProcess::VirtualRigProcess(const VirtualRigScenario& scenario, std::int64_t start_utime,
                                     Sink sink)
    : rig_(std::make_unique<Rig>(scenario, start_utime, std::move(sink))) {}
VirtualRigProcess::~VirtualRigProcess() = default;

double VirtualRigProcess::next_time() const { return rig_->time_of(rig_->next_source()); }

void VirtualRigProcess::step() {
  const std::size_t source = rig_->next_source();
  const double time = rig_->time_of(source);
  const std::int64_t index = rig_->count[source]++;
  switch (source) {
    case kConfiguration:
      return rig_->send_configuration(time);
    case kCurrents:
      return rig_->send_currents(index, time);
    case kHall:
      return rig_->send_hall(index, time);
    default:
      return rig_->send_frame(index, time);
  }
}

std::int64_t VirtualRigProcess::pictures() const { return rig_->pictures; }
std::int64_t VirtualRigProcess::pictures_skipped() const { return rig_->pictures_skipped; }

void VirtualRigProcess::skip_pictures(std::function<bool(double)> skip) {
  rig_->skip = std::move(skip);
}

void VirtualRigProcess::write_surface(const std::string& path) const {
  write_ply(path, rig_->organ.rest());
}

void VirtualRigProcess::write_truth(const std::string& path) const {
  // Others, started meanwhile, read it whole.
  write_whole(path, [this](std::ofstream& file) {
    file << write_configuration(rig_->magnetics.true_configuration());
  });
}

}  // namespace gastronaut

#include "evaluate/evaluate_process.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <gastronaut/depth_image_t.hpp>
#include <gastronaut/hall_array_t.hpp>
#include <gastronaut/image_t.hpp>
#include <gastronaut/map_deformation_t.hpp>
#include <gastronaut/map_surfels_t.hpp>
#include <gastronaut/rig_config_t.hpp>
#include <limits>
#include <span>
#include <stdexcept>

#include "bus/log_file.hpp"
#include "bus/wire.hpp"
#include "evaluate/picture_process.hpp"
#include "process/channels.hpp"
#include "process/pose_messages.hpp"
#include "process/surfel_message.hpp"

namespace gastronaut::evaluation {
namespace {

// A DEPTH picture and its truth may be this many pictures apart in the log.
constexpr std::size_t kMaxPendingPictures = 64;

template <int kSize>
Matrix6d covariance_of(const double (&values)[kSize][kSize]) {
  Matrix6d covariance = Matrix6d::Zero();
  for (int row = 0; row < kSize; ++row) {
    for (int column = 0; column < kSize; ++column) covariance(row, column) = values[row][column];
  }
  return covariance;
}

// Words of a message, fit for a column of a CSV file and the name of a figure.
std::string printable(std::string words) {
  for (char& letter : words) {
    if (!std::isalnum(static_cast<unsigned char>(letter)) && letter != ' ') letter = '_';
  }
  return words;
}

std::vector<PoseStatus> listed(std::span<const PoseStatus> statuses) {
  return {statuses.begin(), statuses.end()};
}

PoseChannel magnetic_pose_channel() {
  return {channel::kMagneticPose,
          PoseKind::kMagnet,
          5,
          listed(kMagneticPoseStatuses),
          {},
          {{"chi2_per_dof", {}},
           {"residual_rms", {}},
           {"moment", {}},
           {"background_x", {}},
           {"background_y", {}},
           {"background_z", {}},
           {"num_channels_used", {}}}};
}

PoseChannel visual_pose_channel() {
  return {channel::kVisualPose,
          PoseKind::kCameraInMap,
          6,
          listed(kVisualPoseStatuses),
          {},
          {{"icp_rms", {}}, {"rgb_rms", {}}, {"inlier_fraction", {}}}};
}

PoseChannel capsule_state_channel() {
  return {channel::kCapsuleState, PoseKind::kCameraInRig, 6, listed(kCapsuleStateStatuses), {},
          {{"depth_scale", {}}}};
}

PoseChannel capsule_pose_channel() {
  return {channel::kCapsulePose, PoseKind::kCameraInRig, 0, {{"OK", true}}, {}, {}};
}

void append(PoseChannel& target, const PoseFix& fix, std::initializer_list<double> extras) {
  target.fixes.push_back(fix);
  auto value = extras.begin();
  for (ExtraSeries& series : target.extras) series.values.push_back(*value++);
}

void append(PoseChannel& target, const magnetic_pose_t& message) {
  append(target,
         {message.utime, message.status, pose_of(message), covariance_of(message.covariance)},
         {message.chi2_per_dof, message.residual_rms, message.moment, message.background[0],
          message.background[1], message.background[2],
          static_cast<double>(message.num_channels_used)});
}

void append(PoseChannel& target, const visual_pose_t& message) {
  append(target,
         {message.utime, message.status, pose_of(message), covariance_of(message.covariance),
          message.map_version},
         {message.icp_rms, message.rgb_rms, message.inlier_fraction});
}

void append(PoseChannel& target, const capsule_state_t& message) {
  append(target,
         {message.utime, message.status, pose_of(message), covariance_of(message.covariance)},
         {message.depth_scale});
}

void append(PoseChannel& target, const pose_t& message) {
  append(target, {message.utime, 0, pose_of(message), {}}, {});
}

class RunReader {
 public:
  RecordedRun read(const std::string& path, const std::function<void(double)>& progress);

 private:
  void handle(const LogReader::Event& event);
  void handle_configuration(const rig_config_t& message);
  void handle_health(const capsule_state_t& message);
  void handle_hall(const hall_array_t& message);
  void handle_depth(depth_image_t message, bool is_truth);
  void handle_map(const map_surfels_t& message);
  void handle_deformation(const map_deformation_t& message);
  void compare(const depth_image_t& estimate, const depth_image_t& truth);
  void add_notes();

  // Decodes; what is damaged or of another type is counted.
  template <class Message>
  std::optional<Message> decode(const LogReader::Event& event) {
    Message message;
    if (decode_message(event.payload, message) == DecodeResult::kOk) return message;
    ++run_.channels[event.channel].corrupt;
    return std::nullopt;
  }
  template <class Message>
  void handle_pose(const LogReader::Event& event, PoseChannel& target) {
    const auto message = decode<Message>(event);
    if (message) append(target, *message);
  }

  RecordedRun run_;
  PoseChannel magnetic_ = magnetic_pose_channel();
  PoseChannel visual_ = visual_pose_channel();
  PoseChannel state_ = capsule_state_channel();
  PoseChannel pose_ = capsule_pose_channel();
  SurfelStore surfels_;
  std::map<std::int64_t, depth_image_t> pending_depth_[2];  // estimates, truth; still encoded
  std::size_t unmatched_depth_ = 0;
  std::size_t undecodable_depth_ = 0;
  std::string configuration_text_;
  bool configuration_changed_ = false;
};

void RunReader::handle_configuration(const rig_config_t& message) {
  if (message.yaml == configuration_text_) return;
  if (!configuration_text_.empty()) {
    configuration_changed_ = true;
    return;
  }
  configuration_text_ = message.yaml;
  run_.configuration_name = message.name;
  run_.code_version = message.code_version;
  try {
    run_.configuration = parse_rig_configuration(message.yaml, "RIG_CONFIG");
    run_.map.stable_confidence = run_.configuration->visual_slam.stable_confidence;
  } catch (const ConfigurationError& error) {
    run_.notes.push_back(std::string("RIG_CONFIG cannot be used, so nothing that needs the "
                                     "magnet's place or the array is computed: ") +
                         error.what());
  }
}

void RunReader::handle_health(const capsule_state_t& message) {
  if (message.status == capsule_state_t::STATUS_INITIALISING) return;
  for (const sensor_health_t& sensor : message.sensors) {
    std::vector<SensorHealth>& series = run_.sensor_health[printable(sensor.name)];
    if (!series.empty() && message.utime < series.back().utime) continue;
    series.push_back(
        {message.utime, sensor.p_nominal, sensor.alpha, sensor.used != 0, printable(sensor.cause)});
  }
}

void RunReader::handle_hall(const hall_array_t& message) {
  HallReading reading{message.utime, {}};
  const double saturation = run_.configuration ? run_.configuration->hall_array.saturation
                                               : std::numeric_limits<double>::infinity();
  for (int sensor = 0; sensor < message.num_sensors; ++sensor) {
    const auto index = static_cast<std::size_t>(sensor);
    for (int axis = 0; axis < message.num_axes; ++axis) {
      const float field = message.field[index][static_cast<std::size_t>(axis)];
      if (message.status[index] != hall_array_t::STATUS_OK || !(std::abs(field) < saturation)) {
        reading.unusable_channels.push_back(sensor * message.num_axes + axis);
      }
    }
  }
  run_.hall_readings.push_back(std::move(reading));
}

void RunReader::handle_depth(depth_image_t message, bool is_truth) {
  auto& others = pending_depth_[is_truth ? 0 : 1];
  const auto other = others.find(message.utime);
  if (other != others.end()) {
    is_truth ? compare(other->second, message) : compare(message, other->second);
    others.erase(other);
    return;
  }
  auto& own = pending_depth_[is_truth ? 1 : 0];
  const std::int64_t utime = message.utime;
  own[utime] = std::move(message);
  if (own.size() > kMaxPendingPictures) {
    own.erase(own.begin());
    if (!is_truth) ++unmatched_depth_;
  }
}

void RunReader::handle_map(const map_surfels_t& message) {
  run_.map.refused += apply_message(message, surfels_);
  run_.map.version = message.map_version;
  run_.map.sizes.push_back(
      {message.utime, surfels_.size(), surfels_.stable(run_.map.stable_confidence)});
}

void RunReader::handle_deformation(const map_deformation_t& message) {
  MapDeformation deformation{message.utime,
                             message.map_version,
                             DeformationKind::kFrame,
                             message.num_nodes,
                             message.num_constraints,
                             message.mean_constraint_error_before,
                             message.mean_constraint_error_after};
  switch (message.kind) {
    case map_deformation_t::KIND_FRAME:
      break;
    case map_deformation_t::KIND_LOCAL_LOOP:
      deformation.kind = DeformationKind::kLocalLoop;
      break;
    case map_deformation_t::KIND_GLOBAL_LOOP:
      deformation.kind = DeformationKind::kGlobalLoop;
      break;
    default:
      ++run_.channels[channel::kMapDeformation].corrupt;
      return;
  }
  for (const std::vector<double>& move : message.translation) {
    deformation.largest_move =
        std::max(deformation.largest_move, std::hypot(move[0], move[1], move[2]));
  }
  run_.map.deformations.push_back(deformation);
}

void RunReader::compare(const depth_image_t& estimate, const depth_image_t& truth) {
  const auto estimated = decode_depth(estimate);
  const auto expected = decode_depth(truth);
  if (!estimated || !expected) {
    ++undecodable_depth_;
    return;
  }
  run_.depth.frames.push_back(
      {estimate.utime, compare_depth(*estimated, *expected, run_.depth.profile)});
}

void RunReader::handle(const LogReader::Event& event) {
  ChannelCount& count = run_.channels[event.channel];
  ++count.messages;
  count.bytes += event.payload.size();
  if (event.channel == channel::kRigConfig) {
    if (const auto message = decode<rig_config_t>(event)) handle_configuration(*message);
  } else if (event.channel == channel::kGroundTruthPose) {
    if (const auto message = decode<rigid_transform_t>(event)) {
      const SE3 pose = pose_of(*message);
      if (pose.translation.allFinite()) run_.truth.add(message->utime, pose);
    }
  } else if (event.channel == channel::kHallArray) {
    if (const auto message = decode<hall_array_t>(event)) handle_hall(*message);
  } else if (event.channel == channel::kMagneticPose) {
    handle_pose<magnetic_pose_t>(event, magnetic_);
  } else if (event.channel == channel::kVisualPose) {
    handle_pose<visual_pose_t>(event, visual_);
  } else if (event.channel == channel::kCapsuleState) {
    if (const auto message = decode<capsule_state_t>(event)) {
      append(state_, *message);
      handle_health(*message);
    }
  } else if (event.channel == channel::kCapsulePose) {
    handle_pose<pose_t>(event, pose_);
  } else if (event.channel == channel::kMapSurfels) {
    if (const auto message = decode<map_surfels_t>(event)) handle_map(*message);
  } else if (event.channel == channel::kMapDeformation) {
    if (const auto message = decode<map_deformation_t>(event)) handle_deformation(*message);
  } else if (event.channel == channel::kDepth || event.channel == channel::kGroundTruthDepth) {
    if (auto message = decode<depth_image_t>(event)) {
      const bool is_truth = event.channel == channel::kGroundTruthDepth;
      if (!is_truth) run_.frame_utimes.push_back(message->utime);
      handle_depth(std::move(*message), is_truth);
    }
  } else if (event.channel == channel::kCamera || event.channel == channel::kAlbedo ||
             event.channel == channel::kVessels) {
    if (const auto message = decode<image_t>(event)) {
      run_.frame_utimes.push_back(message->utime);
      const std::string failure = failure_of(*message);
      if (!failure.empty()) ++run_.failures[failure];
    }
  }
}

void RunReader::add_notes() {
  const auto note = [&](const std::string& text) { run_.notes.push_back(text); };
  if (!run_.damage.empty()) note(run_.damage + "; everything before it was used");
  for (const auto& [name, count] : run_.channels) {
    if (count.corrupt == 0) continue;
    note(std::to_string(count.corrupt) + " of " + std::to_string(count.messages) + " messages of " +
         name + " are damaged or of another type and were left out");
  }
  if (configuration_text_.empty()) {
    note(
        "there is no RIG_CONFIG in the log: where the magnet sits in the capsule is unknown, so "
        "magnetic poses are not compared with the truth");
  }
  if (configuration_changed_) {
    note("RIG_CONFIG changes within the log; the first one was used throughout");
  }
  if (run_.truth.empty()) {
    note("there is no GROUND_TRUTH_POSE in the log: poses are shown, but no errors");
  }
  if (run_.pose_channels.empty()) {
    note("there is no pose channel in the log; was it written by replay?");
  }
  unmatched_depth_ += pending_depth_[0].size();
  if (unmatched_depth_ > 0) {
    note(std::to_string(unmatched_depth_) + " DEPTH pictures have no GROUND_TRUTH_DEPTH");
  }
  if (undecodable_depth_ > 0) {
    note(std::to_string(undecodable_depth_) + " depth pictures cannot be decoded");
  }
  for (const auto& [failure, count] : run_.failures) {
    note(std::to_string(count) + " of " + std::to_string(run_.channels[channel::kAlbedo].messages) +
         " pictures could not be used by depth_estimator: " + failure);
  }
}

RecordedRun RunReader::read(const std::string& path, const std::function<void(double)>& progress) {
  LogReader log(path);
  std::size_t events = 0;
  while (const auto event = log.next()) {
    if (events++ == 0) run_.first_utime = run_.last_utime = event->log_utime;
    run_.first_utime = std::min(run_.first_utime, event->log_utime);
    run_.last_utime = std::max(run_.last_utime, event->log_utime);
    handle(*event);
    progress(static_cast<double>(log.offset()) / static_cast<double>(log.size()));
  }
  run_.damage = log.damage();
  if (events == 0) {
    throw std::runtime_error(run_.damage.empty() ? path + " holds no message" : run_.damage);
  }
  for (PoseChannel* channel : {&magnetic_, &visual_, &state_, &pose_}) {
    if (channel->fixes.empty()) continue;
    run_.pose_channels.push_back(std::move(*channel));
  }
  run_.map.surfels = surfels_.list();
  std::vector<std::int64_t>& utimes = run_.frame_utimes;
  std::sort(utimes.begin(), utimes.end());
  utimes.erase(std::unique(utimes.begin(), utimes.end()), utimes.end());
  add_notes();
  return std::move(run_);
}

}  // namespace

RecordedRun read_run(const std::string& path, const std::function<void(double)>& progress) {
  return RunReader().read(path, progress);
}

}  // namespace gastronaut::evaluation

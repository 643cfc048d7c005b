#include "export/export_process.hpp"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <gastronaut/occupancy_t.hpp>
#include <gastronaut/rig_config_t.hpp>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <stdexcept>

#include "bus/log_file.hpp"
#include "bus/wire.hpp"
#include "configuration/rig_configuration.hpp"
#include "export/message_table.hpp"
#include "process/channels.hpp"
#include "process/pose_messages.hpp"
#include "process/surfel_message.hpp"
#include "process/whole_file.hpp"
#include "surfels/surfel_file.hpp"
#include "surfels/surfel_mesh.hpp"
#include "trajectory/trajectory_file.hpp"

namespace gastronaut {
namespace {

const WireLayout* layout_of(Bytes payload) {
  constexpr std::size_t kFingerprint = 8;
  if (payload.size() < kFingerprint) return nullptr;
  std::uint64_t fingerprint = 0;
  for (std::size_t i = 0; i < kFingerprint; ++i) fingerprint = (fingerprint << 8) | payload[i];
  const WireLayout* layout = layout_of_fingerprint(fingerprint);
  return layout != nullptr && wire_length_matches(*layout, payload) ? layout : nullptr;
}

std::string file_name(const std::string& channel) {
  std::string name = channel;
  for (char& letter : name) {
    const bool plain = (letter >= 'a' && letter <= 'z') || (letter >= 'A' && letter <= 'Z') ||
                       (letter >= '0' && letter <= '9') || letter == '_' || letter == '-';
    if (!plain) letter = '_';
  }
  return name;
}

void for_each_event(const std::string& path, double from, double to,
                    const std::function<void(double)>& progress,
                    const std::function<void(const LogReader::Event&)>& use,
                    std::string* damage = nullptr) {
  LogReader log(path);
  while (const auto event = log.next()) {
    use(*event);
    progress(from +
             (to - from) * static_cast<double>(log.offset()) / static_cast<double>(log.size()));
  }
  if (damage != nullptr) *damage = log.damage();
}

// A text file that appears under its name when it is whole.
class TableFile {
 public:
  explicit TableFile(std::string path)
      : path_(std::move(path)), file_(path_ + ".partial", std::ios::binary | std::ios::trunc) {
    check();
  }

  void line(const std::string& text) { file_ << text << '\n'; }
  void close() {
    file_.close();
    check();
    std::filesystem::rename(path_ + ".partial", path_);
  }

 private:
  void check() const {
    if (!file_) {
      throw std::runtime_error(path_ + ": cannot be written; check the folder and the space left");
    }
  }

  std::string path_;
  std::ofstream file_;
};

class Exporter {
 public:
  explicit Exporter(const ExportOptions& options) : options_(options) {
    after_frames_.insert(options.after_frames.begin(), options.after_frames.end());
  }

  ExportResult run(const std::function<void(double)>& progress) {
    std::string damage;
    constexpr double kFirstPass = 0.4;
    for_each_event(
        options_.log, 0, options_.csv ? kFirstPass : 1, progress,
        [this](const LogReader::Event& event) { handle(event); }, &damage);
    if (!damage.empty()) note(damage + "; everything before it was exported");
    if (options_.ply) write_map();
    if (options_.mesh) write_mesh();
    write_trajectories();
    if (octomap_) {
      const bool bt = octomap_->format == occupancy_t::FORMAT_BT;
      write(bt ? "octomap.bt" : "octomap.ot", [this](std::ofstream& file) {
        file.write(reinterpret_cast<const char*>(octomap_->data.data()),
                   static_cast<std::streamsize>(octomap_->data.size()));
      });
    }
    if (options_.csv) write_tables(kFirstPass, progress);
    if (refused_ > 0) {
      note(std::to_string(refused_) + " surfels of MAP_SURFELS are none and were left out");
    }
    for (const auto& [channel, count] : left_out_) {
      note(channel + ": " + std::to_string(count) +
           " messages are damaged or of another type and were left out");
    }
    return std::move(result_);
  }

 private:
  void note(const std::string& text) { result_.notes.push_back(text); }

  std::string path_of(const std::string& name) const { return options_.folder + "/" + name; }

  void write(const std::string& name, const std::function<void(std::ofstream&)>& fill) {
    write_whole(path_of(name), fill);
    result_.files.push_back(name);
  }

  void handle(const LogReader::Event& event) {
    // liblcm tries each UDP socket with a message on this channel, which lcm-logger records.
    if (event.channel == "LCM_SELF_TEST") return;
    const WireLayout* layout = layout_of(event.payload);
    const auto table =
        layout == nullptr ? tables_.end() : tables_.try_emplace(event.channel, *layout).first;
    if (table == tables_.end() || &table->second.layout() != layout) {
      ++left_out_[event.channel];
      return;
    }
    if (options_.csv) table->second.measure(event.payload);
    if (options_.tum || options_.ply) handle_poses(event);
    if (options_.mesh && event.channel == channel::kRigConfig) {
      if (const auto message = decode<rig_config_t>(event)) configuration_ = message->yaml;
    }
    if ((options_.ply || options_.mesh) && event.channel == channel::kMapSurfels) {
      if (const auto message = decode<map_surfels_t>(event)) handle_surfels(*message);
    }
    if (options_.octomap && event.channel == channel::kOctomap) {
      if (auto message = decode<occupancy_t>(event)) octomap_ = std::move(*message);
    }
  }

  template <class Message>
  std::optional<Message> decode(const LogReader::Event& event) {
    Message message;
    if (decode_message(event.payload, message) == DecodeResult::kOk) return message;
    ++left_out_[event.channel];
    return std::nullopt;
  }

  void handle_poses(const LogReader::Event& event) {
    if (event.channel == channel::kMagneticPose) {
      handle_pose<magnetic_pose_t>(event, kMagneticPoseStatuses);
    } else if (event.channel == channel::kVisualPose) {
      handle_pose<visual_pose_t>(event, kVisualPoseStatuses);
    } else if (event.channel == channel::kCapsuleState) {
      handle_pose<capsule_state_t>(event, kCapsuleStateStatuses);
    } else if (event.channel == channel::kCapsulePose) {
      handle_pose<pose_t>(event, {});
    } else if (event.channel == channel::kGroundTruthPose) {
      handle_pose<rigid_transform_t>(event, {});
    }
  }

  template <class Message>
  void handle_pose(const LogReader::Event& event, std::span<const PoseStatus> statuses) {
    const auto message = decode<Message>(event);
    if (!message) return;
    if constexpr (requires { message->map_version; }) {
      map_versions_.insert(message->map_version);
      ++frames_;
    }
    if constexpr (requires { message->status; }) {
      const auto status = static_cast<std::size_t>(message->status);
      if (message->status < 0 || status >= statuses.size() || !statuses[status].usable) return;
    }
    const SE3 pose = pose_of(*message);
    // Of poses of one time the last one counts, as for those who read such files.
    if (is_finite(pose)) poses_[event.channel][message->utime] = to_pose(pose);
  }

  void handle_surfels(const map_surfels_t& message) {
    refused_ += apply_message(message, surfels_);
    any_surfels_ = true;
    while (!after_frames_.empty() && *after_frames_.begin() <= frames_) {
      const std::size_t after = *after_frames_.begin();
      after_frames_.erase(after_frames_.begin());
      write_surfels_as("map_after_" + std::to_string(after) + ".ply",
                       "map frame, after " + std::to_string(frames_) + " frames");
    }
  }

  void write_surfels_as(const std::string& name, const std::string& comment) {
    write_surfels(path_of(name), surfels_.list(), comment);
    result_.files.push_back(name);
  }

  void write_map() {
    if (!any_surfels_) return;
    write_surfels_as("map.ply", "map frame");
    for (const std::size_t after : after_frames_) {
      note("map_after_" + std::to_string(after) + ".ply: the log has " + std::to_string(frames_) +
           " VISUAL_POSE, and no MAP_SURFELS at or after that many");
    }
  }

  void write_mesh() {
    std::vector<Surfel> stable = surfels_.list();
    const double least = stable_confidence();
    std::erase_if(stable, [least](const Surfel& surfel) { return !is_stable(surfel, least); });
    if (stable.empty()) return;
    export_mesh(path_of("mesh.ply"), triangulate(stable));
    result_.files.push_back("mesh.ply");
  }

  double stable_confidence() {
    if (!configuration_.empty()) {
      try {
        return parse_rig_configuration(configuration_, "RIG_CONFIG").visual_slam.stable_confidence;
      } catch (const ConfigurationError& error) {
        note(std::string("RIG_CONFIG cannot be used; surfels count as stable as by default: ") +
             error.what());
      }
    }
    return VisualSlamConfiguration{}.stable_confidence;
  }

  void write_trajectories() {
    if (!options_.tum) return;
    for (const auto& [channel, poses] : poses_) {
      StampedPoses trajectory;
      for (const auto& [utime, pose] : poses) {
        trajectory.utimes.push_back(utime);
        trajectory.poses.push_back(pose);
      }
      write_tum(path_of(channel + ".tum"), trajectory);
      result_.files.push_back(channel + ".tum");
    }
    if (map_versions_.size() > 1) {
      note("VISUAL_POSE.tum: the map's frame has changed " +
           std::to_string(map_versions_.size() - 1) +
           " times (map_version, in VISUAL_POSE.csv): its poses are not all in one frame");
    }
  }

  void write_tables(double from, const std::function<void(double)>& progress) {
    std::map<std::string, TableFile> files;
    std::set<std::string> names;
    for (const auto& [channel, table] : tables_) {
      std::string name = file_name(channel);
      while (!names.insert(name).second) name += "_";
      TableFile& file = files.try_emplace(channel, path_of(name + ".csv")).first->second;
      file.line(table.header());
      result_.files.push_back(name + ".csv");
    }
    for_each_event(options_.log, from, 1, progress, [&](const LogReader::Event& event) {
      const auto table = tables_.find(event.channel);
      if (table == tables_.end() || layout_of(event.payload) != &table->second.layout()) return;
      files.at(event.channel).line(table->second.row(event.payload));
    });
    for (auto& [channel, file] : files) file.close();
  }

  const ExportOptions& options_;
  ExportResult result_;
  std::map<std::string, MessageTable> tables_;
  std::map<std::string, std::size_t> left_out_;
  std::map<std::string, std::map<std::int64_t, Pose>> poses_;
  std::set<std::int32_t> map_versions_;
  std::size_t frames_ = 0;  // VISUAL_POSE so far
  SurfelStore surfels_;
  bool any_surfels_ = false;
  std::size_t refused_ = 0;
  std::string configuration_;           // RIG_CONFIG's
  std::set<std::size_t> after_frames_;  // still to come
  std::optional<occupancy_t> octomap_;
};

}  // namespace

ExportResult export_log(const ExportOptions& options, const std::function<void(double)>& progress) {
  return Exporter(options).run(progress);
}

}  // namespace gastronaut

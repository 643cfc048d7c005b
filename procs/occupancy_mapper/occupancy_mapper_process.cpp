#include "occupancy_mapper/occupancy_mapper_process.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <memory>
#include <optional>
#include <stdexcept>
#include <utility>

#include "gastronaut/occupancy_t.hpp"
#include "process/channels.hpp"
#include "process/whole_file.hpp"

namespace gastronaut {
namespace {

constexpr double kMicroseconds = 1e6;
constexpr const char* kFullFile = ".ot";

occupancy::OccupancyOptions options_of(const RigConfiguration& configuration) {
  // As SurfelMapOptions: depth from farther away is not used.
  constexpr double kFarthest = 4;  // working distances
  const double working_distance = configuration.visual_slam.working_distance;
  const CameraConfiguration& camera = configuration.camera;
  return {configuration.occupancy_mapper.resolution * working_distance,
          kFarthest * working_distance,
          configuration.occupancy_mapper.pose_age,
          {camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy}};
}

bool ends_with(const std::string& text, const std::string& end) {
  return text.size() > end.size() && text.substr(text.size() - end.size()) == end;
}

// Nothing where the camera was not found, or the numbers cannot be.
std::optional<SE3> camera_pose(const visual_pose_t& message) {
  constexpr double kUnit = 1e-3;  // of a quaternion's norm
  const double* q = message.orientation;
  SE3 pose{Eigen::Quaterniond(q[0], q[1], q[2], q[3]), Eigen::Vector3d(message.position)};
  const bool is_usable = message.status != visual_pose_t::STATUS_LOST &&
                         std::abs(pose.rotation.norm() - 1) < kUnit && pose.translation.allFinite();
  if (!is_usable) return std::nullopt;
  pose.rotation.normalize();
  return pose;
}

occupancy::MapChange map_change(const map_surfels_t& message, double stable_confidence) {
  occupancy::MapChange change;
  change.utime = message.utime;
  change.map_version = message.map_version;
  change.reset = message.reset != 0;
  change.removed = message.removed;
  change.changed.reserve(message.id.size());
  for (std::size_t i = 0; i < message.id.size(); ++i) {
    change.changed.push_back({message.id[i],
                              {message.x[i], message.y[i], message.z[i]},
                              {message.nx[i], message.ny[i], message.nz[i]},
                              static_cast<double>(message.confidence[i]) >= stable_confidence});
  }
  return change;
}

}  // namespace

OccupancyMapperProcess::OccupancyMapperProcess(Bus& bus, const RigConfiguration& configuration,
                                               std::string file)
    : bus_(bus),
      configuration_(configuration.occupancy_mapper),
      stable_confidence_(configuration.visual_slam.stable_confidence),
      file_(std::move(file)),
      map_(options_of(configuration)) {
  // A picture's pose is known before the map that it went into; of one utime it comes first.
  bus.subscribe<visual_pose_t>(channel::kVisualPose, configuration.lag.derived,
                               [this](const visual_pose_t& message) { handle_pose(message); });
  bus.subscribe<map_surfels_t>(channel::kMapSurfels,
                               configuration.lag.derived + configuration.visual_slam.map_interval,
                               [this](const map_surfels_t& message) { handle_surfels(message); });
}

void OccupancyMapperProcess::handle_pose(const visual_pose_t& message) {
  if (const auto pose = camera_pose(message)) {
    map_.add_pose(message.utime, message.map_version, *pose);
  }
}

void OccupancyMapperProcess::handle_surfels(const map_surfels_t& message) {
  const occupancy::MapChangeReport changes = map_.apply(map_change(message, stable_confidence_));
  is_whole_ = is_whole_ || message.reset != 0;
  unusable_ += changes.unusable;
  unseen_ = changes.unseen;
  surfels_ = static_cast<std::int64_t>(message.id.size());
  utime_ = message.utime;
  is_published_ = false;
  if (utime_ >= publish_due_) {
    publish();
    publish_due_ = utime_ + std::llround(configuration_.map_interval * kMicroseconds);
  }
  report();
}

void OccupancyMapperProcess::publish() {
  const std::optional<double> clearance = map_.clearance();
  const std::optional<double> coverage = map_.coverage();
  comments_ = {{"utime", std::to_string(utime_)},
               {"map_version", std::to_string(map_.map_version())}};
  if (clearance) comments_.push_back({"clearance", fmt::format("{:.6g}", *clearance)});
  if (coverage) comments_.push_back({"coverage", fmt::format("{:.6g}", *coverage)});
  measures_.clear();
  if (clearance) measures_ = fmt::format("clearance {:.1f} mm", 1e3 * *clearance);
  if (coverage) {
    measures_ += measures_.empty() ? "" : ", ";
    measures_ += fmt::format("{:.1f} % of the wall seen", 1e2 * *coverage);
  }

  const std::string tree = map_.tree().as_bt(comments_);
  occupancy_t message{};
  message.utime = utime_;
  message.map_version = map_.map_version();
  message.resolution = map_.tree().getResolution();
  message.format = occupancy_t::FORMAT_BT;
  message.data.assign(tree.begin(), tree.end());
  message.size = static_cast<std::int32_t>(message.data.size());
  bus_.publish(channel::kOctomap, message);
  is_published_ = true;
  if (!file_.empty() && utime_ >= save_due_) {
    keep();
    save_due_ = utime_ + std::llround(configuration_.save_interval * kMicroseconds);
  }
}

void OccupancyMapperProcess::keep() {
  file_problem_.clear();
  try {
    const std::string tree =
        ends_with(file_, kFullFile) ? map_.tree().as_ot(comments_) : map_.tree().as_bt(comments_);
    write_whole(file_, [&tree](std::ofstream& file) { file << tree; });
  } catch (const std::runtime_error& error) {
    file_problem_ = error.what();
  }
}

void OccupancyMapperProcess::report() {
  std::string text = measures_;
  const auto add = [&text](const std::string& more) { text += (text.empty() ? "" : "; ") + more; };
  if (unusable_ > 0) {
    add(fmt::format("{} surfels of MAP_SURFELS left out: their numbers are impossible", unusable_));
  }
  if (!is_whole_) {
    add("the map from before this process listened is not known: start visual_slam after it, or "
        "wait until the map is told anew");
  }
  // Some are always out of view: what was bent or set elsewhere.
  const bool is_unseen = 2 * unseen_ > surfels_;
  if (is_unseen) {
    add(
        fmt::format("{} of {} surfels were seen by none of the last poses: free space is not known "
                    "there; is VISUAL_POSE missing?",
                    unseen_, surfels_));
  }
  if (!file_problem_.empty()) add(file_problem_);
  const bool well = is_whole_ && !is_unseen && file_problem_.empty();
  bus_.set_health(well ? ProcessState::kRunning : ProcessState::kDegraded, text);
}

void OccupancyMapperProcess::finish() {
  save_due_ = utime_;
  if (is_published_) {
    if (!file_.empty()) keep();
  } else {
    publish();
  }
  report();
  if (!file_problem_.empty()) spdlog::error("{}", file_problem_);
}

ProcessDescription occupancy_mapper_process() {
  const auto file = std::make_shared<std::string>();
  return {"occupancy_mapper",
          "Keeps an octree of occupied, free and never-seen space.",
          channel::kMapSurfels,
          [](const RigConfiguration&) { return std::vector<std::string>{channel::kOctomap}; },
          [file](Bus& bus, const RigConfiguration& configuration) {
            return std::make_unique<OccupancyMapperProcess>(bus, configuration, *file);
          },
          [file](CLI::App& app) {
            app.add_option("--octomap", *file,
                           "keep the octree in this file, .bt (occupied or free) or .ot (with "
                           "probabilities): every occupancy_mapper.save_interval seconds and at "
                           "the end")
                ->check([](const std::string& name) {
                  return ends_with(name, ".bt") || ends_with(name, kFullFile)
                             ? std::string()
                             : name + ": must end in .bt or .ot";
                });
          }};
}

}  // namespace gastronaut

#include "visual_slam/visual_slam_process.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <limits>
#include <stdexcept>
#include <utility>

#include "gastronaut/map_deformation_t.hpp"
#include "gastronaut/map_surfels_t.hpp"
#include "gastronaut/visual_pose_t.hpp"
#include "pictures/depth_counts.hpp"
#include "process/channels.hpp"
#include "visual_slam/surfel_file.hpp"

namespace gastronaut {
namespace {

constexpr double kMicroseconds = 1e6;
// Surfels in one message live: 2 MB, a fraction of the receive buffer.
constexpr std::size_t kMostSurfels = 50'000;
constexpr std::int64_t kLargestSide = 16384;  // pixels, as the configuration's camera

std::optional<std::string> metadata(const image_t& picture, const std::string& key) {
  for (const image_metadata_t& entry : picture.metadata) {
    if (entry.key == key) return std::string(entry.value.begin(), entry.value.end());
  }
  return std::nullopt;
}

slam::PictureHealth health_of(const image_t& albedo) {
  slam::PictureHealth health;
  health.failure = metadata(albedo, "failure").value_or("");
  health.failure_message = metadata(albedo, "failure_message").value_or("");
  if (const auto text = metadata(albedo, "sharpness")) {
    double sharpness = 0;
    const auto [end, error] = std::from_chars(text->data(), text->data() + text->size(), sharpness);
    if (error == std::errc() && sharpness > 0 && sharpness < 1e3) health.sharpness = sharpness;
  }
  return health;
}

bool finite(std::initializer_list<double> values) {
  return std::all_of(values.begin(), values.end(),
                     [](double value) { return std::isfinite(value); });
}

// Nothing for a message that is not a depth picture.
std::optional<slam::DepthCounts> depth_counts(const depth_image_t& message) {
  const bool possible = message.width > 0 && message.width <= kLargestSide && message.height > 0 &&
                        message.height <= kLargestSide &&
                        finite({message.fx, message.fy, message.cx, message.cy,
                                message.metres_per_count, message.relative_std}) &&
                        message.fx > 0 && message.fy > 0 && message.metres_per_count > 0 &&
                        message.relative_std >= 0 && message.relative_std <= 1;
  const std::optional<DepthEncoding> encoding = depth_encoding(message.encoding);
  if (!possible || !encoding) return std::nullopt;
  auto counts = decode_depth_counts(*encoding, message.data, message.width, message.height);
  if (!counts) return std::nullopt;
  return slam::DepthCounts{
      {message.width, message.height, message.fx, message.fy, message.cx, message.cy},
      std::move(*counts),
      message.metres_per_count,
      message.relative_std};
}

// ALBEDO comes on the pixels of the undistorted camera. Nothing for another kind of picture.
std::optional<slam::AlbedoLevels> albedo_levels(const image_t& message,
                                                const CameraConfiguration& camera) {
  const std::size_t pixels =
      static_cast<std::size_t>(camera.width) * static_cast<std::size_t>(camera.height);
  if (message.pixelformat != image_t::PIXEL_FORMAT_GRAY || message.width != camera.width ||
      message.height != camera.height || message.row_stride != camera.width ||
      message.data.size() != pixels) {
    return std::nullopt;
  }
  return slam::AlbedoLevels{
      {camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy}, message.data};
}

// Nothing for a state that cannot be one. A capsule is no farther than `farthest` metres from the
// array's middle.
std::optional<slam::FusedState> fused_state(const capsule_state_t& message, double farthest) {
  constexpr double kUnit = 1e-3;  // of a quaternion's norm
  constexpr double kMostScale = 2;
  slam::FusedState state;
  state.utime = message.utime;
  state.is_nominal = message.status == capsule_state_t::STATUS_NOMINAL;
  state.is_known = state.is_nominal || message.status == capsule_state_t::STATUS_DEGRADED;
  const double* q = message.orientation;
  state.rig_T_camera.rotation = Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  state.rig_T_camera.translation = Eigen::Vector3d(message.position);
  state.velocity = Eigen::Vector3d(message.velocity);
  state.angular_velocity = Eigen::Vector3d(message.angular_velocity);
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) state.covariance(i, j) = message.covariance[i][j];
  }
  const bool possible = std::abs(state.rig_T_camera.rotation.norm() - 1) < kUnit &&
                        state.rig_T_camera.translation.norm() < farthest &&
                        state.velocity.norm() < farthest &&
                        state.angular_velocity.norm() < 2 * M_PI / kUnit &&
                        state.covariance.allFinite() && state.covariance.diagonal().minCoeff() >= 0;
  if (!possible) return std::nullopt;
  state.rig_T_camera.rotation.normalize();
  if (message.depth_scale >= 1 / kMostScale && message.depth_scale <= kMostScale) {
    state.depth_scale = message.depth_scale;
  }
  return state;
}

slam::VisualSlamOptions options_of(const RigConfiguration& configuration) {
  const VisualSlamConfiguration& chosen = configuration.visual_slam;
  slam::VisualSlamOptions options;
  options.tracker.rgb_weight = chosen.rgb_weight;
  options.map.working_distance = chosen.working_distance;
  options.map.stable_confidence = chosen.stable_confidence;
  options.deform = chosen.deformation;
  return options;
}

// An examination does not wait for a map that cannot be read: that is set aside, and it starts
// without one.
slam::VisualSlam make_slam(const RigConfiguration& configuration, const std::string& map_file) {
  if (map_file.empty() || !std::filesystem::exists(map_file)) {
    return slam::VisualSlam(options_of(configuration));
  }
  std::optional<slam::KeptMap> kept;
  try {
    kept = slam::load_map(map_file);
  } catch (const std::runtime_error& refusal) {
    const std::string aside = map_file + ".refused";
    std::filesystem::rename(map_file, aside);
    spdlog::warn("{}; it is {} now, and a new map is begun", refusal.what(), aside);
    return slam::VisualSlam(options_of(configuration));
  }
  spdlog::info("{}: a map of {} surfels, seen from {} places", map_file, kept->surfels.size(),
               kept->viewpoints.size());
  return slam::VisualSlam(options_of(configuration), std::move(*kept));
}

std::uint8_t level(float albedo) {
  return static_cast<std::uint8_t>(std::lround(255 * std::clamp(albedo, 0.0F, 1.0F)));
}

void add_surfel(const slam::SurfelArrays& surfels, std::int32_t id, map_surfels_t& message) {
  const auto k = static_cast<std::size_t>(id);
  message.id.push_back(id);
  message.x.push_back(surfels.x[k]);
  message.y.push_back(surfels.y[k]);
  message.z.push_back(surfels.z[k]);
  message.nx.push_back(surfels.nx[k]);
  message.ny.push_back(surfels.ny[k]);
  message.nz.push_back(surfels.nz[k]);
  const std::uint8_t grey = level(surfels.albedo[k]);
  message.red.push_back(grey);
  message.green.push_back(grey);
  message.blue.push_back(grey);
  message.radius.push_back(surfels.radius[k]);
  message.confidence.push_back(surfels.confidence[k]);
}

map_deformation_t message_of(const slam::MapDeformation& bend, int map_version) {
  map_deformation_t message{};
  message.utime = bend.utime;
  message.map_version = map_version;
  message.kind = static_cast<std::int8_t>(bend.kind);
  const std::vector<slam::DeformationNode>& nodes = bend.graph.nodes();
  message.num_nodes = static_cast<std::int32_t>(nodes.size());
  for (const slam::DeformationNode& node : nodes) {
    const Eigen::Matrix<double, 3, 3, Eigen::RowMajor> affine = node.affine;
    const auto values = [](const auto& matrix) {
      return std::vector<double>(matrix.data(), matrix.data() + matrix.size());
    };
    message.position.push_back(values(node.position));
    message.affine.push_back(values(affine));
    message.translation.push_back(values(node.translation));
  }
  message.num_constraints = bend.constraints;
  message.mean_constraint_error_before = bend.report.mean_error_before;
  message.mean_constraint_error_after = bend.report.mean_error_after;
  return message;
}

}  // namespace

VisualSlamProcess::VisualSlamProcess(Bus& bus, const RigConfiguration& configuration,
                                     std::string map_file)
    : bus_(bus),
      configuration_(configuration),
      map_file_(std::move(map_file)),
      slam_(make_slam(configuration, map_file_)),
      keeper_(map_file_) {
  // ALBEDO first: of one utime it is handled before DEPTH.
  bus.subscribe<image_t>(
      channel::kAlbedo, configuration.lag.derived,
      [this](const image_t& message) { handle_albedo(message); }, Overload::kKeepNewest);
  bus.subscribe<depth_image_t>(
      channel::kDepth, configuration.lag.derived,
      [this](const depth_image_t& message) { handle_depth(message); }, Overload::kKeepNewest);
  bus.subscribe_feedback<capsule_state_t>(
      channel::kCapsuleState, configuration.lag.feedback,
      [this](const capsule_state_t& message) { handle_state(message); });
}

void VisualSlamProcess::handle_albedo(const image_t& message) {
  merge_alone();
  if (albedo_) publish_lost(albedo_->utime, "no depth", "ALBEDO came without its DEPTH");
  albedo_ = message;
}

void VisualSlamProcess::handle_depth(const depth_image_t& message) {
  merge_alone();
  const std::optional<image_t> albedo = std::exchange(albedo_, std::nullopt);
  if (albedo && albedo->utime == message.utime) {
    handle_frame(*albedo, message);
    return;
  }
  if (albedo) publish_lost(albedo->utime, "no depth", "ALBEDO came without its DEPTH");
  publish_lost(message.utime, "no albedo", "DEPTH came without its ALBEDO");
}

// A frame's way: tracked against the map, fused with the magnetics by another process, merged into
// the map, the map's news published.
void VisualSlamProcess::handle_frame(const image_t& albedo, const depth_image_t& depth) {
  const auto levels = albedo_levels(albedo, configuration_.camera);
  const auto counts = depth_counts(depth);
  if (!levels || !counts) {
    publish_lost(
        depth.utime, "corrupt",
        fmt::format("{} of {}x{} cannot be used: not what the configuration's camera gives",
                    levels ? "DEPTH" : "ALBEDO", levels ? depth.width : albedo.width,
                    levels ? depth.height : albedo.height));
    return;
  }
  slam::Frame frame;
  slam::SlamPose pose;
  try {
    frame = assemble_frame(depth.utime, *counts, *levels, configuration_.visual_slam.max_width);
    pose = slam_.track(frame, health_of(albedo));
  } catch (const std::invalid_argument& error) {
    publish_lost(depth.utime, "corrupt", error.what());
    return;
  }
  publish(pose);
}

void VisualSlamProcess::handle_state(const capsule_state_t& message) {
  constexpr double kFarthest = 1000;  // working distances
  const auto state = fused_state(message, kFarthest * configuration_.visual_slam.working_distance);
  fusion_problem_.clear();
  if (!state) {
    fusion_problem_ = "a CAPSULE_STATE is not used: its numbers are impossible";
  } else if (!state->depth_scale) {
    fusion_problem_ = "CAPSULE_STATE's depth_scale is not used: not within 0.5 and 2";
  }
  if (unmerged_ == message.utime) merge(state);
}

// The answer to the frame before has not come, and will not.
void VisualSlamProcess::merge_alone() {
  if (!unmerged_) return;
  fusion_problem_ = "sensor_fusion is silent: the map is merged at vision's own poses";
  merge(std::nullopt);
}

void VisualSlamProcess::merge(const std::optional<slam::FusedState>& fused) {
  const std::int64_t utime = *std::exchange(unmerged_, std::nullopt);
  slam_.merge(fused);
  publish_deformations();
  if (utime >= map_due_) {
    publish_map(utime, kMostSurfels);
    map_due_ = utime + std::llround(configuration_.visual_slam.map_interval * kMicroseconds);
  }
  if (!map_file_.empty() && utime >= save_due_ && slam_.map().size() > 0) {
    if (keeper_.is_free()) keeper_.save(slam_.kept());
    save_due_ = utime + std::llround(configuration_.visual_slam.save_interval * kMicroseconds);
  }
}

void VisualSlamProcess::publish_lost(std::int64_t utime, const std::string& kind,
                                     const std::string& message) {
  merge_alone();
  publish(slam_.lost(utime, {.failure = kind, .failure_message = message}));
}

void VisualSlamProcess::publish(const slam::SlamPose& pose) {
  visual_pose_t message{};
  message.utime = pose.utime;
  message.map_version = pose.map_version;
  message.status = static_cast<std::int8_t>(pose.status);
  const Eigen::Vector3d& t = pose.map_T_camera.translation;
  const Eigen::Quaterniond& q = pose.map_T_camera.rotation;
  std::copy_n(t.data(), 3, message.position);
  const double wxyz[] = {q.w(), q.x(), q.y(), q.z()};
  std::copy_n(wxyz, 4, message.orientation);
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) message.covariance[i][j] = pose.covariance(i, j);
  }
  message.icp_rms = pose.icp_rms;
  message.rgb_rms = pose.rgb_rms;
  message.inlier_fraction = pose.inlier_fraction;
  bus_.publish(channel::kVisualPose, message);
  last_utime_ = pose.utime;
  unmerged_ = pose.utime;
  if (!bus_.await(channel::kCapsuleState, pose.utime)) merge_alone();
  report(pose);
}

// What has changed since the last message, in portions that the network carries.
void VisualSlamProcess::publish_map(std::int64_t utime, std::size_t most) {
  map_surfels_t message{};
  message.utime = utime;
  message.map_version = slam_.map_version();
  message.reset = announced_frame_ == slam_.map_frame() ? 0 : 1;
  // In another frame all surfels are new: the rest of what was under way is among them.
  if (message.reset != 0) published_ = increment_.changed.size();
  announced_frame_ = slam_.map_frame();
  if (published_ == increment_.changed.size()) {
    increment_ = slam_.take_increment();
    published_ = 0;
    message.removed = increment_.removed;
  }
  const slam::SurfelArrays& surfels = slam_.map().surfels();
  const std::size_t end = std::min(increment_.changed.size(), published_ + most);
  for (; published_ < end; ++published_) {
    const std::int32_t id = increment_.changed[published_];
    if (surfels.holds(static_cast<std::size_t>(id))) add_surfel(surfels, id, message);
  }
  message.num_surfels = static_cast<std::int32_t>(message.id.size());
  message.num_removed = static_cast<std::int32_t>(message.removed.size());
  bus_.publish(channel::kMapSurfels, message);
}

void VisualSlamProcess::publish_deformations() {
  for (const std::string& refusal : slam_.take_refusals()) {
    ++refused_loops_;
    spdlog::debug("no loop is closed here: {}", refusal);
  }
  for (const slam::MapDeformation& bend : slam_.take_deformations()) {
    constexpr const char* kKinds[] = {"vision's drift from the fused pose", "a loop",
                                      "a loop found by its looks"};
    const auto kind = static_cast<std::size_t>(bend.kind);
    const char* cause = bend.is_wall ? "a wall that moved" : kKinds[kind];
    if (!bend.report.is_accepted()) {
      spdlog::debug("{}: the map does not bend for {}: {}", bend.utime, cause, bend.report.refusal);
      continue;
    }
    spdlog::debug(
        "{}: the map bends for {}: {} nodes, {} constraints, off by {:.3g} mm, then {:.3g}",
        bend.utime, cause, bend.graph.nodes().size(), bend.constraints,
        1e3 * bend.report.mean_error_before, 1e3 * bend.report.mean_error_after);
    ++bends_[kind];
    last_bend_ =
        fmt::format("the last by {:.2g} mm, {:.2g} mm are left",
                    1e3 * bend.report.mean_error_before, 1e3 * bend.report.mean_error_after);
    bus_.publish(channel::kMapDeformation, message_of(bend, slam_.map_version()));
  }
}

void VisualSlamProcess::report(const slam::SlamPose& pose) {
  ++frames_;
  if (pose.status == slam::SlamStatus::kLost) ++lost_;
  std::string text;
  const auto add = [&text](const std::string& more) { text += (text.empty() ? "" : "; ") + more; };
  if (pose.status == slam::SlamStatus::kRelocalised) {
    restarts_ += pose.cause.empty() ? 0 : 1;
  } else if (!pose.cause.empty()) {
    last_cause_ = pose.cause;
  }
  if (!last_cause_.empty()) {
    add(fmt::format("{} of {} frames lost, last cause: {}", lost_, frames_, last_cause_));
  }
  if (restarts_ > 0) add(fmt::format("began again by what fusion knows {} times", restarts_));
  if (slam_.agreements() + refused_loops_ > 0) {
    add(fmt::format("{} keyframes lie on what was mapped long ago, {} do not fit it",
                    slam_.agreements(), refused_loops_));
  }
  if (!last_bend_.empty()) {
    add(fmt::format("the map bent {} times, {} loops closed, {} of them found by their looks; {}",
                    bends_[0] + bends_[1] + bends_[2], bends_[1] + bends_[2], bends_[2],
                    last_bend_));
  }
  if (!fusion_problem_.empty()) add(fusion_problem_);
  if (!map_file_.empty() && !keeper_.problem().empty()) {
    add("the map is not kept: " + keeper_.problem());
  }
  const bool well =
      pose.status == slam::SlamStatus::kOk || pose.status == slam::SlamStatus::kRelocalised;
  bus_.set_health(well ? ProcessState::kRunning : ProcessState::kDegraded, text);
}

void VisualSlamProcess::finish() {
  if (albedo_) {
    publish_lost(albedo_->utime, "no depth", "ALBEDO came without its DEPTH");
    albedo_.reset();
  }
  merge_alone();
  slam_.settle();
  // Twice: the rest of the portion under way, and what has changed since it was taken.
  constexpr std::size_t kAll = std::numeric_limits<std::size_t>::max();
  if (published_ < increment_.changed.size()) publish_map(last_utime_ + 1, kAll - published_);
  if (slam_.map().size() > 0) publish_map(last_utime_ + 2, kAll);
  if (!map_file_.empty() && slam_.map().size() > 0) {
    keeper_.wait();
    keeper_.save(slam_.kept());
    keeper_.wait();
    if (!keeper_.problem().empty()) spdlog::error("{}", keeper_.problem());
  }
}

ProcessDescription visual_slam_process() {
  const auto map_file = std::make_shared<std::string>();
  return {"visual_slam",
          "Tracks the camera against its own dense map, and builds that map.",
          channel::kDepth,
          [](const RigConfiguration&) {
            return std::vector<std::string>{channel::kVisualPose, channel::kMapSurfels,
                                            channel::kMapDeformation};
          },
          [map_file](Bus& bus, const RigConfiguration& configuration) {
            return std::make_unique<VisualSlamProcess>(bus, configuration, *map_file);
          },
          [map_file](CLI::App& app) {
            app.add_option("--map", *map_file,
                           "keep the map in this file: go on with it if it is there, save it every "
                           "visual_slam.save_interval seconds");
          }};
}

}  // namespace gastronaut

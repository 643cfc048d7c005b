// The process visual_slam: DEPTH and ALBEDO in; VISUAL_POSE for each of them out, MAP_SURFELS a few
// times a second, MAP_DEFORMATION whenever the map has bent; and CAPSULE_STATE, sensor_fusion's
// answer to each VISUAL_POSE.
//
// A frame is tracked, its VISUAL_POSE published, and merged once the CAPSULE_STATE of its utime has
// come; no other event is handled before. Where that stays away, the frame is merged without.
// VISUAL_POSE is vision's own, in the map's frame; its map_version says when that frame became the
// rig's, or tracking began again where fusion has the camera. MAP_SURFELS then begins anew. When
// the map bends, vision's frame stays, so that MAP_DEFORMATION carries the version that holds
// already; unless there is no fusion: then vision goes with the map, to a new version.
//
// A frame is a DEPTH and an ALBEDO of one utime; where one of the two is missing, or the picture
// could not be used, VISUAL_POSE says LOST. The first MAP_SURFELS has `reset` set; colours are the
// albedo's grey. When a log ends, or the process, what was not yet published of the map follows.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "gastronaut/capsule_state_t.hpp"
#include "gastronaut/depth_image_t.hpp"
#include "gastronaut/image_t.hpp"
#include "process/process.hpp"
#include "visual_slam/frame_assembly.hpp"
#include "visual_slam/map_keeper.hpp"
#include "visual_slam/visual_slam.hpp"

namespace gastronaut {

class VisualSlamProcess : public Process {
 public:
  // The map is kept in `map_file`: read at the start if it is there, kept up to date; empty: none.
  // Throws std::runtime_error for a kept map that cannot be read.
  VisualSlamProcess(Bus& bus, const RigConfiguration& configuration, std::string map_file);

  void finish() override;

 private:
  void handle_albedo(const image_t& message);
  void handle_depth(const depth_image_t& message);
  void handle_frame(const image_t& albedo, const depth_image_t& depth);
  void handle_state(const capsule_state_t& message);
  void merge_alone();
  void merge(const std::optional<slam::FusedState>& fused);
  void publish_lost(std::int64_t utime, const std::string& kind, const std::string& message);
  void publish(const slam::SlamPose& pose);
  void publish_map(std::int64_t utime, std::size_t most);
  void publish_deformations();
  void report(const slam::SlamPose& pose);

  Bus& bus_;
  RigConfiguration configuration_;
  std::string map_file_;
  slam::VisualSlam slam_;
  slam::MapKeeper keeper_;

  std::optional<image_t> albedo_;         // waits for its DEPTH
  slam::MapIncrement increment_;          // being published
  std::size_t published_ = 0;             // of increment_.changed
  std::optional<int> announced_frame_;    // of the map as it was last published
  std::optional<std::int64_t> unmerged_;  // utime of the frame that awaits its CAPSULE_STATE
  std::int64_t last_utime_ = 0;
  std::int64_t map_due_ = 0;  // utime of the next MAP_SURFELS
  std::int64_t save_due_ = 0;
  std::int64_t frames_ = 0;
  std::int64_t lost_ = 0;
  std::string last_cause_;
  std::int64_t restarts_ = 0;  // at a fused pose
  std::string fusion_problem_;
  std::array<std::int64_t, 3> bends_{};  // of the map, by kind
  std::int64_t refused_loops_ = 0;
  std::string last_bend_;
};

ProcessDescription visual_slam_process();

}  // namespace gastronaut

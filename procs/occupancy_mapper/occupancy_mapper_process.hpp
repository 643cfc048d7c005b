// The process occupancy_mapper: MAP_SURFELS and VISUAL_POSE in, OCTOMAP out once a second.
//
// Surfels and the poses that saw them have to be in one frame: MAP_SURFELS and VISUAL_POSE always
// are (the map's frame; the rig's since the map was brought there), CAPSULE_STATE is not before.
//
// The octree's header carries what the wire type has no member for, as comments that octomap's
// readers skip: "# clearance 0.0123" (metres, OccupancyMap::clearance), "# coverage 0.834" (0..1,
// OccupancyMap::coverage), "# utime" and "# map_version". The same goes into PROCESS_STATUS.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "gastronaut/map_surfels_t.hpp"
#include "gastronaut/visual_pose_t.hpp"
#include "occupancy_mapper/occupancy_map.hpp"
#include "process/process.hpp"

namespace gastronaut {

class OccupancyMapperProcess : public Process {
 public:
  // `file`: the octree is kept there, as .bt or .ot; empty: nowhere.
  OccupancyMapperProcess(Bus& bus, const RigConfiguration& configuration, std::string file = {});

  void finish() override;

 private:
  void handle_pose(const visual_pose_t& message);
  void handle_surfels(const map_surfels_t& message);
  void publish();
  void keep();
  void report();

  Bus& bus_;
  OccupancyMapperConfiguration configuration_;
  double stable_confidence_;
  std::string file_;
  occupancy::OccupancyMap map_;
  std::int64_t utime_ = 0;  // of the last MAP_SURFELS
  bool is_whole_ = false;   // the map was told from its beginning
  bool is_published_ = true;
  std::int64_t publish_due_ = 0;
  std::int64_t save_due_ = 0;

  std::int64_t unusable_ = 0;  // surfels since the start
  std::int64_t unseen_ = 0;    // of the last message, and how many surfels it had
  std::int64_t surfels_ = 0;
  std::vector<occupancy::TreeComment> comments_;  // of what was published last
  std::string measures_;                          // clearance and coverage in words
  std::string file_problem_;
};

ProcessDescription occupancy_mapper_process();

}  // namespace gastronaut

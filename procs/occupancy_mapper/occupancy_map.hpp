// Occupied, free and never-seen space from a map of surfels and the camera poses that saw it.
//
// Stable surfels make their voxel occupied; with the last of them it is no longer. Between a
// voxel and the camera that saw it space is free: one line of sight a voxel, however many surfels
// it holds and however often they are seen. Where neither was is unknown. Everything follows the
// map: a surfel that moves takes its voxel and its line of sight along.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <vector>

#include "camera/pinhole_grid.hpp"
#include "geometry/se3.hpp"
#include "occupancy_mapper/occupancy_tree.hpp"
#include "occupancy_mapper/space_blocks.hpp"

namespace gastronaut::occupancy {

struct OccupancyOptions {
  double resolution = 1e-3;  // metres, edge of a voxel
  double farthest = 0.16;    // metres: nothing is seen from farther away
  double pose_age = 2;       // seconds: surfels that are new may have been seen so long ago
  PinholeGrid camera;        // what it sees: without lens distortion, as DEPTH
};

struct MapSurfel {
  std::int32_t id = 0;
  Eigen::Vector3f position = Eigen::Vector3f::Zero();  // metres, map frame
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();    // to where it was seen from
  bool is_stable = false;
};

// What the map's message tells. Removals come before changes.
struct MapChange {
  std::int64_t utime = 0;
  int map_version = 0;
  bool reset = false;  // the map's frame is another one: what was before is forgotten
  std::vector<std::int32_t> removed;
  std::vector<MapSurfel> changed;
};

struct MapChangeReport {
  int unusable = 0;  // surfels whose numbers are impossible; they are left out
  int unseen = 0;    // stable surfels that no known pose can have seen: wall without free space
};

class OccupancyMap {
 public:
  // Throws std::invalid_argument for options that make no sense.
  explicit OccupancyMap(const OccupancyOptions& options);

  // Where a picture was taken, in the frame of that version of the map; utimes ascend. A place
  // beyond all space, or not a number, is left out.
  void add_pose(std::int64_t utime, int map_version, const SE3& map_T_camera);

  // Costs what has changed. Ids that are unknown, or come twice, do no harm.
  //
  // After a reset the lines of sight are found again, if the map is the same in another frame: the
  // similarity between the two is fitted to the surfels' places before and after, and taken where
  // it explains them. If it is another map, the one before is remembered: when its surfels come
  // back where they were, under other ids and out of view, they were seen from where they had been.
  MapChangeReport apply(const MapChange& change);

  // From a camera at the newest pose to the nearest occupied voxel, metres: to its nearest point,
  // so never more than to the surfels in it. Nothing without wall, or when the newest pose is too
  // old or not of the map as it was last told.
  std::optional<double> clearance() const;

  // The share of the wall that was inspected, 0..1: of the surface that bounds the free space that
  // was seen, the part that is wall; the rest opens to space that was never seen, and there is wall
  // behind it that nobody has looked at. In area of block faces (SpaceBlocks::boundary), so it
  // counts openings as if the missing wall were stretched over them; wall that no line of sight
  // reaches is not counted at all. Nothing before there is free space.
  std::optional<double> coverage() const;

  // Up to date with all changes applied so far; the cost is that of what changed since last time.
  const OccupancyTree& tree();

  const SpaceBlocks& space() const { return space_; }
  int map_version() const { return map_version_; }
  // Of a point, metres; nothing when it is beyond all space.
  std::optional<VoxelIndex> voxel_of(const Eigen::Vector3d& position) const;

 private:
  struct Pose {
    std::int64_t utime = 0;
    int map_version = 0;
    SE3 map_T_camera;
  };
  // By id. Eight bytes: there may be millions.
  struct Place {
    std::array<std::uint16_t, 3> voxel{};  // zeros: in none
    std::uint16_t viewpoint = 0;           // index + 1; 0: not known

    bool has_voxel() const { return (voxel[0] | voxel[1] | voxel[2]) != 0; }
    VoxelIndex index() const { return {voxel[0], voxel[1], voxel[2]}; }
  };

  void change_frame(const MapChange& change);
  std::optional<Eigen::Matrix4d> fit_similarity(const MapChange& change) const;
  void forget_old_poses(std::int64_t now);
  bool sees(const Pose& pose, const MapSurfel& surfel) const;
  std::uint16_t find_viewpoint(const MapSurfel& surfel);
  std::uint16_t remembered_viewpoint(const MapSurfel& surfel);
  std::uint16_t viewpoint_at(const Eigen::Vector3d& position);
  void leave(Place& place);
  void enter(Place& place, const VoxelIndex& voxel);
  void look(const VoxelIndex& voxel, std::uint16_t viewpoint);
  Eigen::Vector3d in_voxels(const Eigen::Vector3d& position) const;

  OccupancyOptions options_;
  SpaceBlocks space_;
  OccupancyTree tree_;
  int map_version_ = 0;
  std::deque<Pose> poses_;  // the last pose_age seconds
  std::vector<Place> places_;
  // Where pictures were taken from, metres: one point for each block that the camera was in.
  std::vector<Eigen::Vector3d> viewpoints_;
  std::map<std::array<int, 3>, std::uint16_t> viewpoint_in_;
  struct Memory {
    SpaceBlocks space;
    std::vector<Eigen::Vector3d> viewpoints;
  };
  Memory memory_;  // of the largest map before this one
};

}  // namespace gastronaut::occupancy

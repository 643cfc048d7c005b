// Whether a keyframe shows what was mapped long ago, and where its camera has to be for the two to
// lie on each other (paper, local and global loop closure; Whelan et al., "ElasticFusion", 2015).
//
// First the old part of the map is looked at from where the camera is thought to be; where that
// shows too little, or does not fit, from the places that look alike (relocaliser.hpp). What is
// found must be held in all directions, fit nearly everywhere, lead to the same place again, and
// be where the magnet allows. All this at a coarser resolution than tracking's: a loop is wide.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "geometry/se3.hpp"
#include "visual_slam/frame.hpp"
#include "visual_slam/frame_tracker.hpp"
#include "visual_slam/relocaliser.hpp"
#include "visual_slam/surfel_map.hpp"
#include "visual_slam/wall_motion.hpp"

namespace gastronaut::slam {

struct LoopSearchOptions {
  int most_columns = 160;          // of the pictures that are compared
  double least_overlap = 0.3;      // of the keyframe's pixels with depth: the old map shows them
  double least_inliers = 0.8;      // of the pixels compared: those that fit a wall that is rigid
  double largest_residual = 0.05;  // rms of depth, as a fraction of the distance
  double same_place = 0.01;        // a second look agrees within it, in distances and radians
  int candidates = 2;              // places that look alike, tried
  double global_interval = 1;      // seconds between two such trials
  WallMotionOptions wall;
};

// Where the camera may be, told by others than the map.
struct PlaceGate {
  Eigen::Vector3d position;  // metres, map frame
  double radius = 0;         // metres
};

struct LoopMatch {
  bool is_old = false;     // the camera sees a part of the map that is old, or seems to
  bool is_global = false;  // found by its looks
  bool is_placed = false;  // the camera is where the match has it, whether or not the wall fits
  std::string refusal;     // why it is not used; empty: it is
  SE3 map_T_camera;        // where the camera has to be, of one that is used
  Matrix6d covariance = Matrix6d::Zero();  // as in TrackingResult
  double overlap = 0;
  double inlier_fraction = 0;
  double icp_rms = 0;           // metres
  Frame keyframe;               // coarser,
  ModelView old;                // and what the old map shows from map_T_camera
  std::vector<WallPatch> wall;  // of one that is placed: where part of the old wall has moved

  bool is_accepted() const { return is_old && refusal.empty(); }
};

class LoopSearch {
 public:
  // Throws std::invalid_argument when the grid is too small.
  LoopSearch(const PinholeGrid& grid, const TrackerOptions& tracker,
             const LoopSearchOptions& options);

  // `map_T_camera`: where the keyframe is thought to be; utimes ascend. Reads the map and the
  // places alone, so may run beside what else reads them.
  LoopMatch look(const Frame& keyframe, const SE3& map_T_camera, const SurfelMap& map,
                 const Relocaliser& places, const std::optional<PlaceGate>& gate);

 private:
  LoopMatch look_from(const Frame& keyframe, const SE3& map_T_camera, const SurfelMap& map,
                      const std::optional<PlaceGate>& gate);

  LoopSearchOptions options_;
  int factor_;
  FrameTracker tracker_;
  std::int64_t global_due_ = INT64_MIN;  // utime
};

}  // namespace gastronaut::slam

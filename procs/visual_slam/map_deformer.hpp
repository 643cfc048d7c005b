// What the map's deformation graph is made of as the map grows, and when it has to bend.
//
// Each keyframe adds nodes on the surface that it saw, and itself: where the map has its camera.
// Where sensor fusion had the same camera is a pin. As vision drifts from fusion, the map bends
// until its keyframes are where their pins are (paper: frame-to-model with the magneto-visual
// pose); as the camera comes back to what was mapped long ago, until that and what it sees now lie
// on each other (loop closure), with the pins to keep the whole in its place.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "geometry/se3.hpp"
#include "visual_slam/deformation_graph.hpp"
#include "visual_slam/deformation_solver.hpp"
#include "visual_slam/frame.hpp"
#include "visual_slam/loop_search.hpp"
#include "visual_slam/similarity.hpp"
#include "visual_slam/surfel_arrays.hpp"

namespace gastronaut::slam {

struct MapDeformerOptions {
  double working_distance = 0.05;  // metres, as the map's
  double spacing = 0.15;           // of nodes, in working distances
  double time_reach = 6.7;         // seconds: the map's active window
  // A correction that counts, in distances, and beyond so many of its own sigmas: of the camera's
  // position by fusion; of what is seen by a loop, and then in the keyframe's relative_std as well.
  double least_shift = 0.01;
  double least_loop = 0.005;
  double least_loop_std = 0.6;
  double least_sigmas = 3;
  double pin_interval = 1;   // seconds between two pins: nearer ones err alike
  int pins_to_bend = 3;      // in a row that are off by a correction that counts
  int most_pins = 500;       // beyond it the oldest of those nearest to a newer one goes
  double pin_floor = 0.005;  // one sigma of a pin at least, in working distances
  double loop_std = 0.005;   // of a point of a loop, likewise
  // Nodes are nearly rigid: where only depth along one direction holds them, freer ones would
  // squash the surface.
  DeformationSolverOptions solver = {.rotation = 1000, .regularisation = 30, .robust_sigmas = 3};
};

enum class DeformationKind : std::int8_t { kFrame = 0, kLocalLoop = 1, kGlobalLoop = 2 };

// What has to be solved, with a copy of all that takes.
struct DeformationTask {
  std::int64_t utime = 0;  // of the keyframe that led to it
  DeformationKind kind = DeformationKind::kFrame;
  bool is_wall = false;  // the wall has moved, and what is known of its place with it
  std::vector<DeformationNode> nodes;
  DeformationGraphOptions graph_options;
  DeformationProblem problem;
};
struct MapDeformation {
  std::int64_t utime = 0;
  int map_version = 0;  // in which the bent map is
  DeformationKind kind = DeformationKind::kFrame;
  bool is_wall = false;
  DeformationGraph graph;
  int constraints = 0;
  DeformationReport report;
};
MapDeformation solve(DeformationTask task, const DeformationSolverOptions& options);

// Where a keyframe's camera is, told by fusion.
struct KeyframePin {
  SE3 map_T_camera;
  Matrix6d covariance = Matrix6d::Zero();  // translation m^2, map frame; rotation rad^2, camera
};

class MapDeformer {
 public:
  // Throws std::invalid_argument for options that make no sense.
  explicit MapDeformer(const MapDeformerOptions& options);

  // A keyframe merged into the map at map_T_camera. `is_known_surface`: what it saw was found in
  // the map, and is of one layer with that. One that saw too little to say how the map moves there
  // adds its nodes alone.
  void add(const Frame& keyframe, const SE3& map_T_camera, bool is_known_surface,
           const std::optional<KeyframePin>& pin);

  // Whether what a keyframe at map_T_camera saw lies elsewhere, by what counts, than by its match.
  bool is_displaced(const SE3& map_T_camera, const LoopMatch& match) const;

  // Whether the pins are off by what counts; then it is time to bend the map to them.
  bool is_off_pins() const;
  DeformationTask bend_to_pins() const;
  // A keyframe at map_T_camera has a match in the map of these surfels.
  DeformationTask close_loop(const SE3& map_T_camera, const LoopMatch& match,
                             const SurfelArrays& surfels) const;

  // The old wall goes to where a keyframe at map_T_camera sees it.
  DeformationTask follow_wall(const SE3& map_T_camera, const LoopMatch& match,
                              const SurfelArrays& surfels) const;

  // Nodes and keyframes follow, as surfels do. Returns how that moves, rigidly, what the newest
  // keyframe saw: map frame, by map frame before.
  SE3 follow(const MapDeformation& bend);
  // To another frame; `keeps_pins`: in which pins have their cameras where they had them before.
  void transform(const Similarity& similarity, bool keeps_pins);
  // All that another one of the same frame knows, from before.
  void join(MapDeformer older);
  // Begins anew with a map of unknown keyframes.
  void restart(const SurfelArrays& surfels);

  const std::vector<DeformationNode>& nodes() const { return nodes_; }

 private:
  struct Keyframe {
    std::int64_t utime = 0;
    SE3 map_T_camera;
    double distance = 0;                  // metres
    std::vector<Eigen::Vector3d> points;  // that it saw, camera frame
  };
  struct Pinned {
    Keyframe keyframe;
    KeyframePin pin;
  };

  static SE3 follow(const DeformationGraph& graph, Keyframe& keyframe);
  TimeSpan old_span(const SurfelArrays& surfels, std::int32_t id, std::int64_t now) const;
  void add_nodes(const Frame& keyframe, const SE3& map_T_camera, double distance,
                 bool is_known_surface);
  void thin_pins();
  std::vector<DeformationConstraint> constraints_of_pins() const;
  DeformationGraphOptions graph_options() const;

  MapDeformerOptions options_;
  std::vector<DeformationNode> nodes_;  // at rest
  std::vector<Pinned> pinned_;          // ascending utime
  Keyframe newest_;
};

}  // namespace gastronaut::slam

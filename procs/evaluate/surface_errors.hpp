// How far a map lies from the true surface: where to put the map, and the distances from there.
//
// Two protocols align further by iterated closest points (Besl and McKay, PAMI 14(2), 1992) from a
// first placement: that of Handa et al. (ICRA 2014; ten steps as their program SurfReg takes them,
// kept if the mean distance falls) and the paper's (until the RMSE changes by less than 0.001 cm).
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <vector>

#include "camera/camera_model.hpp"
#include "evaluate/pose_channel.hpp"
#include "evaluate/trajectory.hpp"
#include "evaluate/true_surface.hpp"
#include "geometry/se3.hpp"

namespace gastronaut::evaluation {

using Points = std::vector<Eigen::Vector3d>;  // metres

// The rig_T_map that brings what the cameras saw at `distance` closest to where the true cameras
// would have seen it, over the usable fixes with truth, all of one map frame: unlike an alignment
// of the positions alone, it is well determined for a short or straight path too. Nothing without
// such fixes.
std::optional<SE3> place_by_trajectory(const PoseChannel& channel, const TruthTrack& truth,
                                       double distance);

// From each point at rig_T_map to the nearest point of the surface.
std::vector<double> surface_distances(const TrueSurface& surface, const Points& map_points,
                                      const SE3& rig_T_map);

struct IcpOptions {
  int iterations = 1000;            // at most
  double tolerance = 1e-5;          // metres, change of the RMSE that ends it
  std::size_t most_points = 50000;  // spread over those given
};
struct IcpResult {
  SE3 rig_T_map;
  int iterations = 0;
};
// Each step moves the map, rigidly, so that the points come closest to what was nearest to them.
IcpResult align_to_surface(const TrueSurface& surface, const Points& map_points,
                           const SE3& rig_T_map, const IcpOptions& options);

IcpResult align_as_handa(const TrueSurface& surface, const Points& map_points,
                         const SE3& rig_T_map);
IcpResult align_as_the_paper(const TrueSurface& surface, const Points& map_points,
                             const SE3& rig_T_map);

// Those of `points`, on the surface, that a camera saw from one of the poses.
Points points_in_view(const TrueSurface& surface, const Points& points, const CameraModel& camera,
                      std::span<const SE3> rig_T_camera);

// From each of `points` to the nearest of `cloud`; infinite beyond `reach`.
std::vector<double> cloud_distances(const Points& points, const Points& cloud, double reach);

// Of the values, 0..1; NaN for no values.
double share_within(const std::vector<double>& values, double limit);

}  // namespace gastronaut::evaluation

// Pose of a frame against the predicted view of the map, by joint geometric and photometric
// alignment: E = E_icp + w_rgb E_rgb, minimised by Gauss-Newton on SE(3), coarse to fine
// (Whelan et al., "ElasticFusion", RSS 2015, section on joint tracking; here each residual is
// divided by its own noise, so that E is a log likelihood and w_rgb has no unit).
//
// E_icp compares depths along the frame's rays, which is point-to-plane with projective data
// association, in units of the depth's noise. A depth that was inferred from shading is wrong
// smoothly, not pixel by pixel: its relative_std is taken as an error common to the whole frame,
// which is estimated as a seventh unknown, and one that is common to a patch; a patch then says no
// more than one pixel does. E_rgb compares albedos normalised to their surroundings' contrast.
//
// The covariance is H^-1 M H^-1: H the normal matrix, M the variance of the gradient. M is H times
// how much more the gradients of blocks of 32 x 32 pixels scatter than independent pixels would
// (each term by itself; depth never less than H), and what a shift common to all pixels does.
#pragma once

#include <Eigen/Core>
#include <string>

#include "camera/pinhole_grid.hpp"
#include "geometry/se3.hpp"
#include "visual_slam/frame.hpp"
#include "visual_slam/tracking_pyramid.hpp"

namespace gastronaut::slam {

struct TrackerOptions {
  double icp_weight = 1;     // of E_icp; 0: colour alone
  double rgb_weight = 0.13;  // w_rgb, as in the paper; 0: depth alone
  bool estimate_depth_scale = true;
  double patch = 1.0 / 8;        // extent of smooth depth errors as a fraction of the width
  double depth_floor = 3e-4;     // least noise of depth, as a fraction of it: interpolation
  double distance_gate = 0.1;    // of depth, beyond four relative_std: further off is other tissue
  double cosine_gate = 0.15;     // of the angle between normal and line of sight: least allowed
  double normal_std = 0.03;      // radians: the map's normals are no better, so a surface that
                                 // turns by less holds nothing across its normal
  double misregistration = 0.1;  // pixels, one sigma: what light and shine leave in the albedo
                                 // moves a whole picture as if it were shifted
  double hold = 0.01;            // DEGRADED beyond it: standard deviation of the worst direction,
                                 // radians and fractions of the working distance
  double least_inliers = 0.3;    // LOST below this fraction of points that fit
  double least_visible = 0.02;   // LOST below this fraction of the picture compared
  double largest_residual = 0.05;  // LOST beyond it, beyond relative_std: fraction of depth
  PyramidOptions pyramid;
};

enum class TrackingStatus { kOk, kDegraded, kLost };

struct TrackingResult {
  TrackingStatus status = TrackingStatus::kLost;
  std::string cause;  // empty when kOk
  SE3 map_T_camera;   // the start when kLost
  // Of the twist xi in map_T_camera * exp(xi): translation m^2, rotation rad^2, camera frame.
  // Directions without hold keep the weak prior: the working distance and one radian; there the
  // camera stays at the start. Zero when kLost.
  Matrix6d covariance = Matrix6d::Zero();
  double icp_rms = 0;          // metres to the map's surface, robust
  double rgb_rms = 0;          // normalised albedo (1: the local standard deviation), robust
  double inlier_fraction = 0;  // of the points that both have: those that fit
  double depth_scale = 1;      // factor that the frame's depth needs to fit the map
};

class FrameTracker {
 public:
  // Throws std::invalid_argument when the grid is too small for the pyramid.
  FrameTracker(const PinholeGrid& grid, const TrackerOptions& options);

  // `map_T_camera_start`: where the camera is thought to be; the view should be from near there.
  // Throws std::invalid_argument when frame or model have another grid.
  TrackingResult track(const Frame& frame, const ModelView& model, const SE3& map_T_camera_start);

 private:
  PinholeGrid grid_;
  TrackerOptions options_;
  FramePyramid frame_;
  ModelPyramid model_;
};

}  // namespace gastronaut::slam

// The last keyframes refined together, poses and depths, so that their pictures agree.
//
// Unknowns: each keyframe's pose, and the log ratio of its refined depth to the one given. A depth
// that was inferred from shading is wrong smoothly, and the whole of it by a common factor: so the
// ratio is a smooth random field, given at the nodes of a coarse grid (window_field.hpp), with
// a small part of each point's own. The prior of that field holds the scale too, which pictures
// alone leave free.
// Residuals: normalised albedo of patches around a few hundred points of each keyframe, in this
// keyframe and in all others that see them, after Engel et al., "Direct Sparse Odometry", 2018.
// Gauss-Newton with robust weights; points, then fields are eliminated by the Schur complement.
// The keyframe that leaves is marginalised, with its field and all that its points say, into a
// prior on the poses of the others.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

#include "camera/pinhole_grid.hpp"
#include "geometry/se3.hpp"
#include "image/plane.hpp"
#include "visual_slam/frame.hpp"
#include "visual_slam/similarity.hpp"
#include "visual_slam/window_field.hpp"
#include "visual_slam/window_kernels.hpp"

namespace gastronaut::slam {

struct KeyframeWindowOptions {
  int keyframes = 7;  // refined together
  int points = 250;   // of each keyframe, about
  int iterations = 6;
  double least_gradient = 0.05;  // of normalised albedo per pixel: points have more
  int contrast_reach = 3;  // pixels around each, to whose contrast its albedo is normalised: less
                           // than in tracking, because shading left in the albedo is not as fine
  double contrast_floor = 0.02;  // as in PyramidOptions
  double jump = 0.05;            // as in PyramidOptions
  // Of the ratio's field, as fractions of the picture's width: between nodes, and how far its
  // correlation reaches. Its one sigma is the frame's relative_std.
  double spacing = 1.0 / 12;
  double range = 1.0 / 3;
  double pose_std = 0.05;   // one sigma of the motion from keyframe to keyframe as add was told
                            // it: fraction of the working distance, radians
  double point_std = 0.01;  // one sigma of what the field cannot follow, as a fraction of depth
  double depth_gate = 0.1;  // of depth, beyond four relative_std: what is further off is hidden
  double dependence = 8;    // residuals that say no more than one independent one does
  double scale_std = 0.02;  // one sigma of the error that the depths of all keyframes share, as a
                            // fraction: only the covariance knows of it
};

struct RefinedKeyframe {
  std::int64_t utime = 0;
  SE3 map_T_camera;
  // Of the twist xi in map_T_camera * exp(xi): translation m^2, rotation rad^2, camera frame; of
  // the pose in relation to the first keyframe since the start.
  Matrix6d covariance = Matrix6d::Zero();
  Plane<float> depth;       // the frame's, corrected
  double scale = 1;         // of the correction: its geometric mean
  double relative_std = 0;  // one sigma of the corrected depth as a fraction of it
  int points = 0;           // that another keyframe saw
  double rgb_rms = 0;       // of their residuals, robust: 1 is the local contrast, and much less
                            // than that is agreement
};

class KeyframeWindow {
 public:
  // Throws std::invalid_argument for options that make no sense.
  KeyframeWindow(const PinholeGrid& grid, const KeyframeWindowOptions& options);

  // The newest keyframe, and where it is thought to be. The first one's pose is the map's anchor.
  // Throws std::invalid_argument when the frame has another grid.
  void add(const Frame& frame, const SE3& map_T_camera);
  // All keyframes of the window, oldest first.
  std::vector<RefinedKeyframe> refine();
  // Poses and depths go to another frame and other metres.
  void transform(const Similarity& similarity);
  // Forgets all, for a new start elsewhere.
  void clear();

  std::size_t size() const { return keyframes_.size(); }

 private:
  struct Keyframe {
    std::int64_t utime = 0;
    double relative_std = 0;
    double distance = 0;  // metres, working distance
    Plane<float> depth;
    Texture texture;
    std::vector<WindowPoint> points;
    std::vector<NodeWeights> nodes;  // of the points
    NodeBand prior;                  // information of the field

    SE3 map_T_camera;
    SE3 before_T_camera;    // from the keyframe before, as add was told
    Eigen::VectorXd field;  // log ratios at the nodes
    Eigen::VectorXd own;    // of the points, beyond the field

    double log_ratio(Eigen::Index point) const;
  };
  struct Equations;

  Equations equations(std::size_t first_host, std::size_t end_host) const;
  void add_priors(Equations& equations, std::size_t end) const;
  void step(const Equations& equations, const Eigen::VectorXd& twists);
  void marginalise_oldest();
  RefinedKeyframe refined(std::size_t index, const Equations& equations,
                          const Eigen::MatrixXd& covariance) const;

  PinholeGrid grid_;
  KeyframeWindowOptions options_;
  NodeGrid nodes_;
  std::deque<Keyframe> keyframes_;
  double sigma_;  // of normalised albedo, as the residuals show it
  Eigen::Vector3d anchor_ = Eigen::Vector3d::Zero();  // where the first keyframe was

  // What keyframes that left say about the poses of those that were there then: gradient and
  // normal matrix at these poses.
  Eigen::MatrixXd prior_matrix_;
  Eigen::VectorXd prior_gradient_;
  std::vector<SE3> prior_poses_;
};

}  // namespace gastronaut::slam

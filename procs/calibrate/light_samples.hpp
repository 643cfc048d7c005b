// Pixels of a picture that tell something about the light: neither saturated nor dark, and with
// known depth on smooth wall that no highlight can fall on.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "camera/camera_model.hpp"
#include "geometry/se3.hpp"
#include "image/plane.hpp"

namespace gastronaut {

// The mean of 3 x 3 pixels.
struct LightSample {
  Eigen::Vector3d ray;  // (x, y, 1), camera frame
  double level = 0;     // of the red channel, 0 to 1
  // Where depth is known, the wall's plane there: plane . X = 1 in the camera frame, 1/metres.
  Eigen::Vector3d plane = Eigen::Vector3d::Zero();
  // Number of the place on the wall, from 0: samples of one place share their albedo.
  int place = 0;
};

// Where a camera was, as far as that is known.
struct CameraPosePrior {
  SE3 rig_T_camera;
  // Of the twist (translation, rotation) in the camera frame, twist = log(prior^-1 * true); zero in
  // a direction of which nothing is known.
  Matrix6d information;
  // Unit, camera frame: the axis about which the camera may be turned by any angle, passing through
  // `roll_centre` (metres, camera frame).
  std::optional<Eigen::Vector3d> roll_axis;
  Eigen::Vector3d roll_centre = Eigen::Vector3d::Zero();
};

struct LightPicture {
  double exposure = 1;  // exposure_gain times the picture's own gain
  std::vector<LightSample> samples;
  std::optional<CameraPosePrior> pose;  // none: the samples know their planes and places
};

// Depth along the optical axis on an undistorted pinhole grid of its own; 0: none.
struct DepthMap {
  Plane<float> depth;  // metres
  double fx = 0;       // pixels
  double fy = 0;
  double cx = 0;
  double cy = 0;
};

// What became of the places looked at.
struct SampleCounts {
  std::int64_t used = 0;
  std::int64_t saturated = 0;
  std::int64_t dark = 0;
  std::int64_t without_ray = 0;
  std::int64_t without_depth = 0;
  std::int64_t unsuitable = 0;  // a fold's edge, a grazing view, or where a highlight may fall

  std::int64_t total() const {
    return used + saturated + dark + without_ray + without_depth + unsuitable;
  }
};

// `picture`: red, green, blue. `depth`: where there is no plane that all samples share.
std::vector<LightSample> take_samples(const std::array<Plane<std::uint8_t>, 3>& picture,
                                      const CameraModel& camera,
                                      const std::optional<DepthMap>& depth, SampleCounts& counts);

// Numbers the places of samples with known planes: cubes of the rig frame where the camera's pose
// is known, else all that one picture sees is one place. One a picture, in the same order.
void number_places(const std::vector<std::optional<SE3>>& rig_T_cameras,
                   std::vector<LightPicture>& pictures);

// Of a magnet's fix: position and direction of the moment with their 5 x 5 covariance (position,
// then rotations about perpendicular_basis(axis)). Where the camera is follows but for a turn about
// the magnet's axis. `position_std` (metres) and `angle_std` (radians) are added to the covariance.
CameraPosePrior pose_from_magnet(const Eigen::Vector3d& position, const Eigen::Vector3d& axis,
                                 const Matrix5d& covariance, const SE3& camera_T_magnet,
                                 double position_std, double angle_std);

}  // namespace gastronaut

// How the magnet sits in the camera's frame, and what a 5-DoF fix of it tells of that.
//
// With the camera at map_T_camera = (R, t) of the visual map, map units of `scale` metres, and the
// map at rig_T_map = (Q, q) in the rig, a fix should read
//   position  Q (scale t + R c) + q        c: the magnet's centre in the camera frame
//   axis      Q R a                        a: its axis there, a unit vector
// R, t taken at the fix's time stamp + time_offset. The roll about the axis appears nowhere: it
// cannot be measured, is not needed, and none is invented.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "geometry/se3.hpp"

namespace gastronaut {

// Where vision saw the camera. Times in seconds, of any common origin.
struct VisualFrame {
  double time = 0;
  SE3 map_T_camera;
};

// A magnetic fix in the rig frame; covariance as in magnetic_pose_t: position (m^2), then rotations
// (rad^2) about the two vectors of perpendicular_basis(axis).
struct MagneticFix {
  double time = 0;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();
  Matrix5d covariance = Matrix5d::Identity();
};

// The camera's path between frames.
class VisualTrack {
 public:
  // `frames` in order of time. Two further apart than most_gap (seconds) are not joined.
  VisualTrack(std::vector<VisualFrame> frames, double most_gap);

  struct Sample {
    SE3 map_T_camera;
    Vector6d velocity = Vector6d::Zero();  // twist a second, camera frame
  };
  // Whether `time` lies between two frames that are joined.
  bool covers(double time) const;
  // Interpolated there; elsewhere carried on from the nearest joined frames.
  Sample at(double time) const;
  bool empty() const { return pieces_.empty(); }

 private:
  struct Piece {
    double begin;
    double end;
    SE3 map_T_camera;  // at begin
    Vector6d velocity;
  };
  const Piece& nearest(double time) const;

  std::vector<Piece> pieces_;
};

// Fixes taken while the camera stayed nearly where it was: one pose of the calibration.
struct HandEyePose {
  std::vector<MagneticFix> fixes;
};

// Cuts the fixes that the track covers at their time + time_offset into poses 2 mm or 2 degrees
// apart, further apart where that would make more than `most`.
std::vector<HandEyePose> gather_poses(const VisualTrack& track,
                                      const std::vector<MagneticFix>& fixes, double time_offset,
                                      std::size_t most);

struct HandEye {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  // metres, camera frame
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();   // unit, camera frame
  SE3 rig_T_map;
  double scale = 1;        // rig metres in one of the map's
  double time_offset = 0;  // seconds: a fix stamped t was taken at t + time_offset by the camera
};

// Order of the unknowns. The axis turns by perpendicular_basis(axis) times its two unknowns, the
// map about the rig's axes; scale is logarithmic.
inline constexpr int kCentreAt = 0;
inline constexpr int kAxisAt = 3;
inline constexpr int kMapRotationAt = 5;
inline constexpr int kMapTranslationAt = 8;
inline constexpr int kLogScaleAt = 11;
inline constexpr int kTimeOffsetAt = 12;
inline constexpr int kHandEyeSize = 13;
using HandEyeVector = Eigen::Matrix<double, kHandEyeSize, 1>;
using HandEyeMatrix = Eigen::Matrix<double, kHandEyeSize, kHandEyeSize>;
using HandEyeJacobian = Eigen::Matrix<double, 5, kHandEyeSize>;

HandEye stepped(const HandEye& hand_eye, const HandEyeVector& step);

// What one pose says: fixes averaged. Residual = measured - expected, position then rotation about
// `basis`; to first order a step changes it by -jacobian * step.
struct HandEyeRow {
  HandEyeJacobian jacobian = HandEyeJacobian::Zero();
  Vector5d residual = Vector5d::Zero();
  Matrix5d covariance = Matrix5d::Zero();  // as the fixes report it, independent of each other
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d axis = Eigen::Vector3d::UnitZ();
  Eigen::Matrix<double, 3, 2> basis = Eigen::Matrix<double, 3, 2>::Zero();
  double weight = 1;  // below 1 where the pose does not fit the others
};

// A fix at this camera pose.
HandEyeRow make_row(const HandEye& hand_eye, const VisualTrack::Sample& camera,
                    const MagneticFix& fix);
// Single fixes that are far from the others of their pose count for little.
HandEyeRow make_row(const HandEye& hand_eye, const VisualTrack& track, const HandEyePose& pose);

}  // namespace gastronaut

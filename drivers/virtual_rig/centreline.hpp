// The axis of a hollow organ with the smooth radius of its cavity: where a capsule can go.
#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

namespace gastronaut {

class Centreline {
 public:
  // Axis through `points` (rig frame, metres, roughly equally spaced, at least four) and the
  // cavity's radius there, radius(point number, angle about the axis).
  Centreline(std::vector<Eigen::Vector3d> points,
             const std::function<double(std::size_t, double)>& radius);

  struct Frame {
    Eigen::Vector3d centre;   // metres
    Eigen::Vector3d tangent;  // unit, towards the far end
    Eigen::Vector3d side;     // unit, horizontal, to the left of the tangent
    Eigen::Vector3d up;       // unit
    // Across the axis at an angle in radians: 0 looks down, pi/2 to the side.
    Eigen::Vector3d direction(double angle) const {
      return std::sin(angle) * side - std::cos(angle) * up;
    }
  };

  double length() const { return length_; }  // metres
  // fraction 0..1 along the axis.
  Frame frame(double fraction) const;
  double radius(double fraction, double angle) const;
  // Fraction of the axis' point nearest to `point`.
  double nearest(const Eigen::Vector3d& point) const;

 private:
  std::vector<Eigen::Vector3d> points_;
  Eigen::MatrixXd radius_;  // point by angle step
  double length_ = 0;
};

}  // namespace gastronaut

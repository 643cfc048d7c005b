// Does a surface point keep its value while the camera and its lamp move? Points of a reference
// picture every second are followed through the next two by true depth and true pose, and looked up
// in several kinds of pictures (albedo, luminance, ...) at the same places. Points whose wall moves
// away from where it was drop out.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "evaluate/depth_errors.hpp"
#include "evaluate/pictures.hpp"
#include "geometry/se3.hpp"

namespace gastronaut::evaluation {

struct ConstancyFrame {
  std::int64_t utime = 0;  // microseconds
  SE3 rig_T_camera;
  const DepthPicture& truth;
  PinholeGrid grid;                  // of all pictures
  std::span<const Levels> pictures;  // one a kind; no data anywhere where the first of them is 0
};

// Of one kind of pictures. A point's spread is the standard deviation of its values divided by
// their mean. Spread alone proves nothing, a grey picture has none, so the contrast between points
// comes with it: the standard deviation of the mean values of the points of one reference picture,
// divided by their mean. As the lamp's fall-off across the picture counts as contrast there, the
// local contrast is that between neighbours alone: the RMS of their difference divided by their
// mean and by sqrt(2), which for points that have nothing to do with each other is the same.
struct Constancy {
  double spread = 0;    // median over the points
  double contrast = 0;  // median over the reference pictures
  double local_contrast = 0;
};

class PointConstancy {
 public:
  static constexpr std::int64_t kReferencePeriod = 1000000;  // microseconds
  static constexpr std::int64_t kFollowedFor = 2000000;

  // Frames with ascending utime; each has `kinds` pictures.
  explicit PointConstancy(std::size_t kinds)
      : spreads_(kinds), contrasts_(kinds), local_contrasts_squared_(kinds) {}
  void add(const ConstancyFrame& frame);
  // After the last frame.
  void finish();

  // Points that were seen often enough to have a spread. Without any, there are no results.
  std::size_t points() const { return distance_ratios_.size(); }
  std::size_t references() const { return references_; }  // with such points
  std::vector<Constancy> constancies() const;             // one a kind
  // Median over the points of their largest distance from the lens divided by the smallest: how
  // much the light changed.
  double distance_ratio() const;

 private:
  struct Point {
    int row = 0;  // in the reference's grid of points
    int column = 0;
    Eigen::Vector3d position;  // rig frame, metres
    double nearest = 0;        // metres from the lens
    double farthest = 0;
    std::vector<std::vector<double>> values;  // by kind, by observation
  };
  struct Reference {
    std::int64_t utime = 0;
    std::vector<Point> points;
  };
  void start(const ConstancyFrame& frame);
  void follow(const ConstancyFrame& frame, std::vector<Point>& points) const;
  void settle(const Reference& reference);

  std::vector<Reference> followed_;
  std::vector<std::vector<double>> spreads_;                  // by kind, by point
  std::vector<std::vector<double>> contrasts_;                // by kind, by reference
  std::vector<std::vector<double>> local_contrasts_squared_;  // by kind, by pair of neighbours
  std::vector<double> distance_ratios_;
  std::size_t references_ = 0;
};

}  // namespace gastronaut::evaluation

// Where the magnet might be when nothing is known of it. For a given position a dipole's field is
// linear in its moment, so that every point of a coarse grid is tried by linear least squares;
// the most promising ones are where Levenberg-Marquardt starts.
#pragma once

#include <vector>

#include "magnetic_localizer/magnet_state.hpp"
#include "magnetic_localizer/noise_model.hpp"
#include "magnetic_localizer/sensor_array.hpp"

namespace gastronaut::magnetics {

class GlobalSearch {
 public:
  explicit GlobalSearch(const SensorArray& array, const RigConfiguration& configuration);

  // The best candidates, best first. A few wrong sensors among `information` do no harm.
  std::vector<MagnetState> candidates(const FieldInformation& information) const;

  std::size_t num_points() const { return points_.size(); }

 private:
  // Columns: field at every sensor (all x, all y, all z) per A m^2 along x, y and z.
  using ByMoment = Eigen::Matrix<double, Eigen::Dynamic, 3>;
  struct Point {
    Eigen::Vector3d position;
    ByMoment by_moment;
  };
  struct Candidate {
    MagnetState state;
    std::size_t point;
    double cost;  // sum over sensors of how many standard deviations they are off
  };

  // The best moment and background for a magnet at the point, by linear least squares; leaves the
  // field that they make in `field`.
  MagnetState solve(const Point& point, const FieldInformation& information,
                    Eigen::VectorXd& field) const;

  double moment_;
  double background_std_;
  std::vector<Point> points_;
};

}  // namespace gastronaut::magnetics

// Watches how far the clocks of magnet and camera are apart: fixes that lag behind the path which
// vision sees lie off it by speed times lag.
//
// Linear regression of what fixes and path differ by, on the velocity and on what a wrong rotation
// and scale of the path make of it; all without their means over the last seconds, so that what
// changes slowly (vision's drift, the magnetic bias) takes no part. The filter itself cannot tell:
// its own velocity comes from the very fixes, and noise in it would pass for an offset.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <deque>

namespace gastronaut::fusion {

struct ClockEstimate {
  double offset = 0;  // seconds that a magnetic reading was taken after its utime
  double std = 1e3;   // one sigma, seconds; large while nothing is known
};

class ClockWatch {
 public:
  // Rig frame, metres; utimes ascend.
  void add_fix(std::int64_t utime, const Eigen::Vector3d& magnet_position);
  // Between two frames of vision, which saw the magnet's centre go by `displacement`, metres in the
  // frame of its map.
  void add_path(std::int64_t begin_utime, std::int64_t end_utime,
                const Eigen::Vector3d& displacement, const Eigen::Quaterniond& rig_R_map);
  // What comes next has nothing to do with what was; the estimate stays.
  void forget_path();

  ClockEstimate estimate() const;

 private:
  static constexpr int kUnknowns = 5;  // offset, rotation vector, logarithm of the scale
  // Side by side: fix - path, velocity, path.
  using Sample = Eigen::Matrix3d;
  struct Fix {
    std::int64_t utime = 0;
    Eigen::Vector3d position;
  };
  void add_sample(double interval, const Sample& sample);

  std::deque<Fix> fixes_;  // since the last frame
  std::int64_t last_utime_ = 0;
  bool is_under_way_ = false;  // along a path, with these:
  Eigen::Quaterniond rig_R_map_ = Eigen::Quaterniond::Identity();
  Eigen::Vector3d path_ = Eigen::Vector3d::Zero();  // of all displacements
  Sample mean_ = Sample::Zero();
  // Integrals over seconds, fading.
  double time_ = 0;
  Eigen::Matrix<double, kUnknowns, kUnknowns> normal_ =
      Eigen::Matrix<double, kUnknowns, kUnknowns>::Zero();
  Eigen::Matrix<double, kUnknowns, 1> product_ = Eigen::Matrix<double, kUnknowns, 1>::Zero();
  double square_ = 0;
};

}  // namespace gastronaut::fusion

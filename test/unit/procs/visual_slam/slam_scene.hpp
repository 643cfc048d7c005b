// A wall with folds and vessels 30 mm in front of the map's origin, and what a capsule's camera
// sees of it.
#pragma once

#include <Eigen/Core>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "numerics/counter_random.hpp"
#include "visual_slam/frame.hpp"

namespace gastronaut::slam {

// A quarter of the camera's resolution, so that tests are short.
inline const PinholeGrid kCameraGrid = {160, 120, 83.2, 83.2, 80.4, 58.4};
inline constexpr double kWallDistance = 0.03;  // metres
inline constexpr std::int64_t kPeriod = 50'000;
inline constexpr std::int64_t kStart = 1'700'000'000'000'000;
// A pixel is 0.36 mm on the wall and 0.7 degrees; being found again means being right to a pixel.
inline constexpr double kPixelMetres = 0.36e-3;
inline constexpr double kPixelRadians = 0.012;

// Smooth, -1 to 1, nowhere twice the same within its cells of one unit: random at their corners.
class Blotches {
 public:
  explicit Blotches(std::uint64_t seed) {
    const CounterRandom random(seed, 0);
    for (std::size_t k = 0; k < corners_.size(); ++k) corners_[k] = 2 * random.uniform(k) - 1;
  }
  double operator()(double x, double y) const {
    const double i = std::floor(x);
    const double j = std::floor(y);
    const auto ease = [](double t) { return t * t * (3 - 2 * t); };
    const double a = ease(x - i);
    const double b = ease(y - j);
    return (1 - b) * ((1 - a) * corner(i, j) + a * corner(i + 1, j)) +
           b * ((1 - a) * corner(i, j + 1) + a * corner(i + 1, j + 1));
  }

 private:
  static constexpr int kSide = 128;
  double corner(double i, double j) const {
    const int u = std::clamp(static_cast<int>(i) + kSide / 2, 0, kSide - 1);
    const int v = std::clamp(static_cast<int>(j) + kSide / 2, 0, kSide - 1);
    return corners_[static_cast<std::size_t>(v * kSide + u)];
  }
  std::array<double, kSide * kSide> corners_;
};

// Waves of one unit, or half of it. One sigma is 1.
class Waves {
 public:
  explicit Waves(const CounterRandom& random) {
    for (std::uint64_t k = 0; k < waves_.size(); ++k) {
      const auto [x, y] = random.normal_pair(k);
      waves_[k] = {2 * M_PI * x, 2 * M_PI * y, 2 * M_PI * random.uniform(waves_.size() + k)};
    }
  }
  double operator()(double u, double v) const {
    double sum = 0;
    for (const Eigen::Vector3d& wave : waves_) sum += std::cos(wave.dot(Eigen::Vector3d(u, v, 1)));
    return std::sqrt(2.0 / static_cast<double>(waves_.size())) * sum;
  }

 private:
  std::array<Eigen::Vector3d, 4> waves_;
};

// Metres along z over (x, y); slopes below 0.4.
inline double wall_height(double x, double y) {
  static const Blotches relief(1);
  return kWallDistance + 1e-3 * relief(x / 8e-3, y / 8e-3);
}
inline double wall_albedo(double x, double y) {
  static const Blotches fine(2);
  static const Blotches coarse(3);
  return 0.5 + 0.15 * fine(x / 2.5e-3, y / 2.5e-3) + 0.15 * coarse(x / 6e-3, y / 6e-3);
}

// The noise of depth is each pixel's own, drawn anew for each seed and utime, where relative_std is
// that of a sensor, 1 % or less. Else it is mostly smooth and the tissue's, the same in each frame
// of a seed, as albedo is that is taken for shape.
inline Frame look(const SE3& map_T_camera, std::int64_t utime, double relative_std,
                  double albedo_std = 0, std::uint64_t seed = 0) {
  constexpr int kSteps = 8;        // slopes below a half: each halves the error, or better
  constexpr double kWaves = 0.06;  // metres, width of the picture on the wall
  constexpr double kSensorStd = 0.01;
  const double own_std = relative_std <= kSensorStd ? relative_std : kSensorStd / 4;
  const double smooth_std = relative_std <= kSensorStd ? 0 : relative_std;
  const CounterRandom random(seed, static_cast<std::uint64_t>(utime));
  const Waves waves(CounterRandom(seed, 1));
  Frame frame{utime, kCameraGrid, Plane<float>(kCameraGrid.width, kCameraGrid.height),
              Plane<float>(kCameraGrid.width, kCameraGrid.height), relative_std};
  std::uint64_t pixel = 0;
  for (int v = 0; v < kCameraGrid.height; ++v) {
    for (int u = 0; u < kCameraGrid.width; ++u, ++pixel) {
      const Eigen::Vector3d way =
          map_T_camera.rotation * Eigen::Vector3d((u - kCameraGrid.cx) / kCameraGrid.fx,
                                                  (v - kCameraGrid.cy) / kCameraGrid.fy, 1);
      double depth = kWallDistance;
      Eigen::Vector3d point;
      for (int i = 0; i < kSteps; ++i) {
        point = map_T_camera.translation + depth * way;
        depth += (wall_height(point.x(), point.y()) - point.z()) / way.z();
      }
      const auto [a, b] = random.normal_pair(pixel);
      const double smooth =
          smooth_std > 0 ? smooth_std * waves(point.x() / kWaves, point.y() / kWaves) : 0;
      frame.depth.at(u, v) = static_cast<float>(depth * (1 + own_std * a + smooth));
      frame.albedo.at(u, v) =
          static_cast<float>(wall_albedo(point.x(), point.y()) + albedo_std * b);
    }
  }
  return frame;
}

// A smooth way about the origin, at most 1 mm and 1 degree a frame; the first camera is the map's.
inline SE3 camera_at(int frame) {
  const double t = 0.07 * frame;
  return {so3_exp({0.1 * std::sin(1.3 * t), 0.12 * std::sin(t), 0.15 * std::sin(0.7 * t)}),
          {8e-3 * std::sin(t), 6e-3 * std::sin(1.4 * t), 3e-3 * std::sin(0.9 * t)}};
}

inline int frames_in(double seconds) {
  return static_cast<int>(std::lround(seconds * 1e6 / static_cast<double>(kPeriod)));
}
inline std::int64_t utime_of(int frame) { return kStart + frame * kPeriod; }

struct PoseError {
  double metres = 0;
  double radians = 0;
};
inline PoseError error_of(const SE3& estimate, const SE3& truth) {
  return {(estimate.translation - truth.translation).norm(),
          angle_between(estimate.rotation, truth.rotation)};
}

inline bool is_covariance(const Matrix6d& matrix) {
  if (!matrix.allFinite() || !matrix.isApprox(matrix.transpose(), 1e-9)) {
    return matrix.isZero(0);
  }
  const auto values = Eigen::SelfAdjointEigenSolver<Matrix6d>(matrix).eigenvalues();
  return values(0) >= -1e-9 * values(5);  // of the largest: rounding
}

}  // namespace gastronaut::slam

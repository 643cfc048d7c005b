// Surfaces whose depth along every ray is known, and frames of them.
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstdint>
#include <functional>

#include "numerics/counter_random.hpp"
#include "visual_slam/frame.hpp"

namespace gastronaut::slam {

// A quarter of the camera's resolution in use, so that tests are short.
inline const PinholeGrid kSceneGrid = {80, 60, 48, 48, 39.5, 29.5};
constexpr double kFrameRate = 30;  // a second
constexpr std::int64_t kFramePeriod = 33'333;

// Distance to the surface from `origin` along `direction` in multiples of it; 0: none.
using Surface =
    std::function<double(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction)>;

inline Surface plane(const Eigen::Vector3d& point, const Eigen::Vector3d& normal) {
  return [=](const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
    return std::max(0.0, normal.dot(point - origin) / normal.dot(direction));
  };
}

// Seen from inside.
inline Surface sphere(const Eigen::Vector3d& centre, double radius) {
  return [=](const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
    const Eigen::Vector3d from = origin - centre;
    const double a = direction.squaredNorm();
    const double b = from.dot(direction);
    return (-b + std::sqrt(b * b - a * (from.squaredNorm() - radius * radius))) / a;
  };
}

inline double true_depth(const Surface& surface, const SE3& map_T_camera, int u, int v) {
  const Eigen::Vector3d ray((u - kSceneGrid.cx) / kSceneGrid.fx,
                            (v - kSceneGrid.cy) / kSceneGrid.fy, 1);
  return surface(map_T_camera.translation, map_T_camera.rotation * ray);
}

// Depth times 1 + relative_std * a standard normal, drawn anew for each utime.
inline Frame frame_of(const Surface& surface, const SE3& map_T_camera, std::int64_t utime,
                      double relative_std = 0) {
  const CounterRandom random(1, static_cast<std::uint64_t>(utime));
  Frame frame;
  frame.utime = utime;
  frame.grid = kSceneGrid;
  frame.relative_std = relative_std;
  frame.depth = Plane<float>(kSceneGrid.width, kSceneGrid.height);
  frame.albedo = Plane<float>(kSceneGrid.width, kSceneGrid.height, 0.5F);
  std::uint64_t pixel = 0;
  for (int v = 0; v < kSceneGrid.height; ++v) {
    for (int u = 0; u < kSceneGrid.width; ++u, ++pixel) {
      frame.depth.at(u, v) = static_cast<float>(true_depth(surface, map_T_camera, u, v) *
                                                (1 + relative_std * random.normal(pixel)));
    }
  }
  return frame;
}

inline SE3 pose(const Eigen::Vector3d& translation, const Eigen::Vector3d& rotation_vector) {
  return {so3_exp(rotation_vector), translation};
}

}  // namespace gastronaut::slam

// Analytic surfaces under lights beside the lens, rendered light by light and pixel by pixel.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <functional>
#include <numbers>

#include "depth_estimator/shape_from_shading.hpp"

namespace gastronaut::perception {

struct SurfacePoint {
  Eigen::Vector3d position;  // metres, camera frame
  Eigen::Vector3d normal;    // unit, towards the camera
};
// Where the ray (x, y, 1) meets the surface.
using Surface = std::function<SurfacePoint(const Eigen::Vector3d& ray)>;

inline Surface plane_through(const Eigen::Vector3d& point, const Eigen::Vector3d& normal) {
  const Eigen::Vector3d n = normal.normalized();
  return [=](const Eigen::Vector3d& ray) -> SurfacePoint {
    return {point.dot(n) / ray.dot(n) * ray, n};
  };
}

// Seen from inside, or from outside when the camera is outside.
inline Surface sphere(const Eigen::Vector3d& centre, double radius) {
  return [=](const Eigen::Vector3d& ray) -> SurfacePoint {
    const bool inside = centre.norm() < radius;
    const double a = ray.squaredNorm();
    const double b = ray.dot(centre);
    const double root = std::sqrt(b * b - a * (centre.squaredNorm() - radius * radius));
    const double along = (b + (inside ? root : -root)) / a;
    const Eigen::Vector3d outwards = (along * ray - centre) / radius;
    return {along * ray, inside ? Eigen::Vector3d(-outwards) : outwards};
  };
}

inline double light_on(const SurfacePoint& patch, const LightsConfiguration& lights) {
  double sum = 0;
  for (int k = 0; k < lights.count; ++k) {
    const double angle = 2 * std::numbers::pi * k / lights.count + lights.phase;
    const Eigen::Vector3d at(lights.radius * std::cos(angle), lights.radius * std::sin(angle), 0);
    const Eigen::Vector3d way = at - patch.position;
    const double distance = way.norm();
    const double emission = std::pow(-way.z() / distance, lights.lobe);
    sum += emission / (distance * distance) * std::max(0.0, patch.normal.dot(way) / distance);
  }
  return sum;
}

struct LitSurface {
  PinholeGrid grid;
  Shading shading;
  Plane<float> depth;  // true, metres
};

inline LitSurface light_surface(const PinholeGrid& grid, const LightsConfiguration& lights,
                                const Surface& surface, double data_std) {
  LitSurface lit{grid,
                 {Plane<float>(grid.width, grid.height), Plane<float>(grid.width, grid.height)},
                 Plane<float>(grid.width, grid.height)};
  for (int v = 0; v < grid.height; ++v) {
    for (int u = 0; u < grid.width; ++u) {
      const SurfacePoint patch = surface({(u - grid.cx) / grid.fx, (v - grid.cy) / grid.fy, 1});
      lit.depth.at(u, v) = static_cast<float>(patch.position.z());
      lit.shading.log_light.at(u, v) = static_cast<float>(std::log(light_on(patch, lights)));
      lit.shading.inverse_variance.at(u, v) = static_cast<float>(1 / (data_std * data_std));
    }
  }
  return lit;
}

}  // namespace gastronaut::perception

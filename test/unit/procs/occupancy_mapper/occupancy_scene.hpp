// Walls seen from inside, for which space is known in closed form.
#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>
#include <vector>

#include "occupancy_mapper/occupancy_map.hpp"

namespace gastronaut::occupancy {

constexpr double kResolution = 1e-3;  // metres
constexpr double kDiagonal = 1.7320508075688772 * kResolution;
constexpr double kBlock = kBlockSide * kResolution;
// Surfels less than half a voxel apart leave no voxel of the wall without one, but for corners.
constexpr double kSpacing = 0.4e-3;

// Pinhole that sees 90 degrees, so that six of them see everything.
inline OccupancyOptions scene_options() {
  OccupancyOptions options;
  options.resolution = kResolution;
  options.camera = {100, 100, 50, 50, 49.5, 49.5};
  return options;
}

inline MapSurfel surfel(std::int32_t id, const Eigen::Vector3d& position,
                        const Eigen::Vector3d& normal) {
  return {id, position.cast<float>(), normal.cast<float>(), true};
}

// Points of equal area on a sphere around the origin (Fibonacci lattice), normals inward.
inline std::vector<MapSurfel> sphere(double radius) {
  const double area = 4 * std::numbers::pi * radius * radius;
  const int count = static_cast<int>(area / (kSpacing * kSpacing));
  std::vector<MapSurfel> result;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (2 * i + 1.0) / count;
    const double angle = i * 2 * std::numbers::pi / std::numbers::phi;
    const double r = std::sqrt(1 - z * z);
    const Eigen::Vector3d direction(r * std::cos(angle), r * std::sin(angle), z);
    result.push_back(surfel(i, radius * direction, -direction));
  }
  return result;
}

// A tube along z from -half_length to half_length, open at both ends, normals inward.
inline std::vector<MapSurfel> tube(double radius, double half_length) {
  const int around = static_cast<int>(2 * std::numbers::pi * radius / kSpacing);
  const int along = static_cast<int>(2 * half_length / kSpacing);
  std::vector<MapSurfel> result;
  for (int j = 0; j < along; ++j) {
    for (int i = 0; i < around; ++i) {
      const double angle = 2 * std::numbers::pi * i / around;
      const Eigen::Vector3d inward(-std::cos(angle), -std::sin(angle), 0);
      const Eigen::Vector3d axis(0, 0, half_length * ((2 * j + 1.0) / along - 1));
      result.push_back(
          surfel(static_cast<std::int32_t>(result.size()), axis - radius * inward, inward));
    }
  }
  return result;
}

// A square facing the origin along z, at that distance, with ids from 0.
inline std::vector<MapSurfel> plate(double distance, double half_side) {
  const int side = static_cast<int>(2 * half_side / kSpacing);
  std::vector<MapSurfel> result;
  for (int j = 0; j < side; ++j) {
    for (int i = 0; i < side; ++i) {
      const Eigen::Vector3d position((i - (side - 1) / 2.0) * kSpacing,
                                     (j - (side - 1) / 2.0) * kSpacing, distance);
      result.push_back(
          surfel(static_cast<std::int32_t>(result.size()), position, -Eigen::Vector3d::UnitZ()));
    }
  }
  return result;
}

// From one place into all six directions, a millisecond apart. Returns the last utime.
inline std::int64_t look_around(OccupancyMap& map, const Eigen::Vector3d& position,
                                std::int64_t utime, int map_version = 0) {
  constexpr double kQuarter = std::numbers::pi / 2;
  const auto look = [&](double angle, const Eigen::Vector3d& axis) {
    utime += 1000;
    map.add_pose(utime, map_version,
                 {Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis)), position});
  };
  look(kQuarter, Eigen::Vector3d::UnitX());
  look(-kQuarter, Eigen::Vector3d::UnitX());
  look(kQuarter, Eigen::Vector3d::UnitY());
  look(-kQuarter, Eigen::Vector3d::UnitY());
  look(2 * kQuarter, Eigen::Vector3d::UnitY());
  look(0, Eigen::Vector3d::UnitZ());
  return utime;
}

inline MapChange change_of(std::vector<MapSurfel> surfels, std::int64_t utime = 0) {
  MapChange change;
  change.utime = utime;
  change.changed = std::move(surfels);
  return change;
}

}  // namespace gastronaut::occupancy

#include "evaluate/seen_surface.hpp"

#include <Eigen/Geometry>
#include <cmath>
#include <optional>

#include "numerics/parallel.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr double kLargestDifference = 0.2;  // of depths, as a fraction of the true one
// Neighbouring pixels whose depths differ by more lie on different parts of the surface.
constexpr double kLargestStep = 0.1;  // as a fraction of the depth

Eigen::Vector3d seen_by(const DepthPicture& picture, int u, int v) {
  const double depth =
      picture.depth[static_cast<std::size_t>(v) * static_cast<std::size_t>(picture.width) +
                    static_cast<std::size_t>(u)];
  return depth * Eigen::Vector3d((u - picture.cx) / picture.fx, (v - picture.cy) / picture.fy, 1);
}

// From a point in the camera's frame to the tangent plane of what its pixel shows; nothing where
// that is another part of the surface or cannot be told.
std::optional<double> distance_to(const DepthPicture& picture, const Eigen::Vector3d& point) {
  if (!(point.z() > 0)) return std::nullopt;
  const double u = std::round(picture.fx * point.x() / point.z() + picture.cx);
  const double v = std::round(picture.fy * point.y() / point.z() + picture.cy);
  // Pixels at the rim have no neighbours for a normal.
  if (!(u >= 1 && v >= 1 && u < picture.width - 1 && v < picture.height - 1)) return std::nullopt;
  const int column = static_cast<int>(u);
  const int row = static_cast<int>(v);
  const Eigen::Vector3d truth = seen_by(picture, column, row);
  if (!(std::abs(point.z() - truth.z()) <= kLargestDifference * truth.z()) || truth.z() <= 0) {
    return std::nullopt;
  }
  const Eigen::Vector3d left = seen_by(picture, column - 1, row);
  const Eigen::Vector3d right = seen_by(picture, column + 1, row);
  const Eigen::Vector3d above = seen_by(picture, column, row - 1);
  const Eigen::Vector3d below = seen_by(picture, column, row + 1);
  for (const Eigen::Vector3d& neighbour : {left, right, above, below}) {
    if (std::abs(neighbour.z() - truth.z()) > kLargestStep * truth.z()) return std::nullopt;
  }
  const Eigen::Vector3d normal = (right - left).cross(below - above).normalized();
  return std::abs(normal.dot(point - truth));
}

}  // namespace

SeenSurface::SeenSurface(std::span<const Surfel> surfels, const SE3& rig_T_map) {
  points_.reserve(surfels.size());
  for (const Surfel& surfel : surfels) {
    points_.push_back({rig_T_map * surfel.position.cast<double>(),
                       rig_T_map.rotation * surfel.normal.cast<double>(), surfel.measured_utime});
  }
}

void SeenSurface::add(std::int64_t utime, const DepthPicture& truth, const SE3& rig_T_camera) {
  const SE3 camera_T_rig = rig_T_camera.inverse();
  constexpr std::size_t kChunk = 4096;
  parallel_for_chunks(points_.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Point& point = points_[i];
      if (utime > point.measured_utime) continue;
      if (point.normal.dot(rig_T_camera.translation - point.position) <= 0) continue;
      const auto distance = distance_to(truth, camera_T_rig * point.position);
      if (distance) point.distance = *distance;
    }
  });
}

std::vector<double> SeenSurface::distances() const {
  std::vector<double> result;
  for (const Point& point : points_) {
    if (!std::isnan(point.distance)) result.push_back(point.distance);
  }
  return result;
}

}  // namespace gastronaut::evaluation

#include "evaluate/surface_errors.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "evaluate/point_grid.hpp"
#include "evaluate/trajectory_errors.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr std::size_t kChunk = 2048;

double root_mean_square(const Eigen::Matrix3Xd& differences) {
  return std::sqrt(differences.squaredNorm() / static_cast<double>(differences.cols()));
}

double nearest_of(const PointGrid& grid, const Eigen::Vector3d& place, double reach) {
  double best2 = reach * reach;
  bool found = false;
  grid.visit_around(place, [&](std::size_t, const Eigen::Vector3d& point) {
    const double distance2 = (point - place).squaredNorm();
    if (distance2 > best2) return;
    best2 = distance2;
    found = true;
  });
  return found ? std::sqrt(best2) : std::numeric_limits<double>::infinity();
}

}  // namespace

std::optional<SE3> place_by_trajectory(const PoseChannel& channel, const TruthTrack& truth,
                                       double distance) {
  // Ahead and to all sides: neither direction of the picture counts for more.
  const std::array<Eigen::Vector3d, 4> seen = {{{distance, distance, distance},
                                                {distance, -distance, -distance},
                                                {-distance, distance, -distance},
                                                {-distance, -distance, distance}}};
  std::vector<Eigen::Vector3d> estimated;
  std::vector<Eigen::Vector3d> expected;
  for (const PoseFix& fix : channel.fixes) {
    const auto rig_T_camera = truth.at(fix.utime);
    if (!channel.usable(fix) || !rig_T_camera) continue;
    for (const Eigen::Vector3d& point : seen) {
      estimated.push_back(fix.pose * point);
      expected.push_back(*rig_T_camera * point);
    }
  }
  if (estimated.empty()) return std::nullopt;
  const auto columns = [](const std::vector<Eigen::Vector3d>& points) {
    return Eigen::Map<const Eigen::Matrix3Xd>(points.front().data(), 3,
                                              static_cast<Eigen::Index>(points.size()));
  };
  const Eigen::Matrix4d transform = Eigen::umeyama(columns(estimated), columns(expected), false);
  return SE3{Eigen::Quaterniond(transform.topLeftCorner<3, 3>()).normalized(),
             transform.topRightCorner<3, 1>()};
}

std::vector<double> surface_distances(const TrueSurface& surface, const Points& map_points,
                                      const SE3& rig_T_map) {
  std::vector<double> distances(map_points.size());
  parallel_for_chunks(distances.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector3d point = rig_T_map * map_points[i];
      distances[i] = (surface.nearest(point) - point).norm();
    }
  });
  return distances;
}

IcpResult align_to_surface(const TrueSurface& surface, const Points& map_points,
                           const SE3& rig_T_map, const IcpOptions& options) {
  IcpResult result{rig_T_map};
  if (map_points.empty()) return result;
  const std::size_t step = (map_points.size() + options.most_points - 1) / options.most_points;
  Eigen::Matrix3Xd chosen(3, static_cast<Eigen::Index>((map_points.size() + step - 1) / step));
  for (Eigen::Index i = 0; i < chosen.cols(); ++i) {
    chosen.col(i) = map_points[static_cast<std::size_t>(i) * step];
  }
  Eigen::Matrix3Xd nearest(3, chosen.cols());
  const auto find_nearest = [&] {
    parallel_for_chunks(static_cast<std::size_t>(chosen.cols()), kChunk,
                        [&](std::size_t begin, std::size_t end) {
                          for (std::size_t k = begin; k < end; ++k) {
                            const auto i = static_cast<Eigen::Index>(k);
                            nearest.col(i) = surface.nearest(result.rig_T_map * chosen.col(i));
                          }
                        });
    Eigen::Matrix3Xd differences(3, chosen.cols());
    for (Eigen::Index i = 0; i < chosen.cols(); ++i) {
      differences.col(i) = result.rig_T_map * Eigen::Vector3d(chosen.col(i)) - nearest.col(i);
    }
    return root_mean_square(differences);
  };
  double rmse = find_nearest();
  while (result.iterations < options.iterations) {
    const Eigen::Matrix4d transform = Eigen::umeyama(chosen, nearest, false);
    result.rig_T_map = {Eigen::Quaterniond(transform.topLeftCorner<3, 3>()).normalized(),
                        transform.topRightCorner<3, 1>()};
    ++result.iterations;
    const double before = rmse;
    rmse = find_nearest();
    if (std::abs(before - rmse) < options.tolerance) break;
  }
  return result;
}

IcpResult align_as_handa(const TrueSurface& surface, const Points& map_points,
                         const SE3& rig_T_map) {
  constexpr int kSteps = 10;
  const IcpResult aligned =
      align_to_surface(surface, map_points, rig_T_map, {.iterations = kSteps, .tolerance = 0});
  const auto mean_at = [&](const SE3& placement) {
    return statistics(surface_distances(surface, map_points, placement)).mean;
  };
  if (mean_at(aligned.rig_T_map) <= mean_at(rig_T_map)) return aligned;
  return {rig_T_map, 0};
}

IcpResult align_as_the_paper(const TrueSurface& surface, const Points& map_points,
                             const SE3& rig_T_map) {
  return align_to_surface(surface, map_points, rig_T_map, {});
}

Points points_in_view(const TrueSurface& surface, const Points& points, const CameraModel& camera,
                      std::span<const SE3> rig_T_camera) {
  std::vector<SE3> camera_T_rig;
  for (const SE3& pose : rig_T_camera) camera_T_rig.push_back(pose.inverse());
  const CameraIntrinsics& picture = camera.intrinsics();
  const auto in_picture = [&](const Eigen::Vector3d& point) {
    const auto pixel = camera.project(point);
    return pixel && pixel->x() > -0.5 && pixel->y() > -0.5 && pixel->x() < picture.width - 0.5 &&
           pixel->y() < picture.height - 0.5;
  };
  std::vector<char> seen(points.size(), 0);
  parallel_for_chunks(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      for (std::size_t k = 0; k < camera_T_rig.size() && seen[i] == 0; ++k) {
        seen[i] = in_picture(camera_T_rig[k] * points[i]) &&
                  surface.sees(rig_T_camera[k].translation, points[i]);
      }
    }
  });
  Points result;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (seen[i] != 0) result.push_back(points[i]);
  }
  return result;
}

std::vector<double> cloud_distances(const Points& points, const Points& cloud, double reach) {
  const PointGrid grid(cloud, reach);
  std::vector<double> distances(points.size());
  parallel_for_chunks(points.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) distances[i] = nearest_of(grid, points[i], reach);
  });
  return distances;
}

double share_within(const std::vector<double>& values, double limit) {
  if (values.empty()) return std::nan("");
  const auto within =
      std::count_if(values.begin(), values.end(), [limit](double value) { return value <= limit; });
  return static_cast<double>(within) / static_cast<double>(values.size());
}

}  // namespace gastronaut::evaluation

#include "virtual_rig/organ_shape.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

namespace gastronaut {
namespace {

constexpr std::size_t kAxisPoints = 97;
// Exponent of the tube's profile against the unit sphere's: below one the ends are blunter.
constexpr double kBluntness = 0.8;

// Points on the unit sphere as a grid of n x n cells on each face of a cube, joined at the edges.
TriangleMesh cube_sphere(int n) {
  TriangleMesh sphere;
  std::map<std::array<int, 3>, std::uint32_t> numbers;
  const auto vertex = [&](const std::array<int, 3>& at) {
    const auto [entry, added] =
        numbers.try_emplace(at, static_cast<std::uint32_t>(sphere.vertices.size()));
    if (added) {
      Eigen::Vector3d point;
      for (int i = 0; i < 3; ++i) {
        // Equal angles rather than equal steps: cells of about equal size.
        const double step = 2.0 * at[static_cast<std::size_t>(i)] / n - 1;
        point[i] = std::tan(step * std::numbers::pi / 4);
      }
      sphere.vertices.push_back(point.normalized().cast<float>());
    }
    return entry->second;
  };
  for (std::size_t axis = 0; axis < 3; ++axis) {
    for (const int side : {0, n}) {
      for (int i = 0; i < n; ++i) {
        for (int j = 0; j < n; ++j) {
          const auto corner = [&](int di, int dj) {
            std::array<int, 3> at{};
            at[axis] = side;
            at[(axis + 1) % 3] = i + di;
            at[(axis + 2) % 3] = j + dj;
            return vertex(at);
          };
          const std::uint32_t a = corner(0, 0);
          const std::uint32_t b = corner(1, 0);
          const std::uint32_t c = corner(1, 1);
          const std::uint32_t d = corner(0, 1);
          // Anticlockwise as seen from inside.
          if (side == 0) {
            sphere.triangles.push_back({a, b, c});
            sphere.triangles.push_back({a, c, d});
          } else {
            sphere.triangles.push_back({a, c, b});
            sphere.triangles.push_back({a, d, c});
          }
        }
      }
    }
  }
  return sphere;
}

double surface_area(const TriangleMesh& mesh) {
  double area = 0;
  for (const Triangle& t : mesh.triangles) {
    const Eigen::Vector3f& a = mesh.vertices[t[0]];
    area += static_cast<double>((mesh.vertices[t[1]] - a).cross(mesh.vertices[t[2]] - a).norm());
  }
  return area / 2;
}

// Relative radius of the tube where the unit sphere has x = along.
double profile(const OrganConfiguration& organ, double along) {
  const double sphere = std::sqrt(std::max(0.0, 1 - along * along));
  return std::pow(sphere, kBluntness) * (1 - organ.taper * (1 + along) / 2);
}

// The axis turns slowly at the near end and more towards the far end: a J.
std::vector<Eigen::Vector3d> bent_axis(const OrganConfiguration& organ) {
  std::vector<Eigen::Vector3d> points{Eigen::Vector3d::Zero()};
  const double step = organ.length / static_cast<double>(kAxisPoints - 1);
  for (std::size_t i = 1; i < kAxisPoints; ++i) {
    const double s = (static_cast<double>(i) - 0.5) / static_cast<double>(kAxisPoints - 1);
    const double heading = organ.bend * (s * s * (3 - 2 * s) * 0.6 + s * s * 0.4);
    points.push_back(points.back() +
                     step * Eigen::Vector3d(std::cos(heading), std::sin(heading), 0));
  }
  return points;
}

Eigen::Vector3d box_centre(const TriangleMesh& mesh) {
  Eigen::Vector3f low = mesh.vertices.front();
  Eigen::Vector3f high = low;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    low = low.cwiseMin(vertex);
    high = high.cwiseMax(vertex);
  }
  return (0.5F * (low + high)).cast<double>();
}

TriangleMesh tube(const OrganConfiguration& organ, const Centreline& axis, int cells) {
  TriangleMesh mesh = cube_sphere(cells);
  for (Eigen::Vector3f& vertex : mesh.vertices) {
    const Eigen::Vector3d on_sphere = vertex.cast<double>();
    const double across = on_sphere.tail<2>().norm();
    const Centreline::Frame frame = axis.frame((1 + on_sphere.x()) / 2);
    Eigen::Vector3d point = frame.centre;
    if (across > 0) {
      const double radius = profile(organ, on_sphere.x());
      point += radius * (organ.width / 2 * on_sphere.y() / across * frame.side +
                         organ.height / 2 * on_sphere.z() / across * frame.up);
    }
    vertex = point.cast<float>();
  }
  return mesh;
}

}  // namespace

OrganShape procedural_stomach(const OrganConfiguration& organ) {
  const auto radius = [&](std::size_t point, double angle) {
    const double along = 2.0 * static_cast<double>(point) / (kAxisPoints - 1) - 1;
    return profile(organ, along) /
           std::hypot(std::sin(angle) / (organ.width / 2), std::cos(angle) / (organ.height / 2));
  };
  std::vector<Eigen::Vector3d> points = bent_axis(organ);
  constexpr int kCoarseCells = 24;
  const TriangleMesh coarse = tube(organ, Centreline(points, radius), kCoarseCells);
  const Eigen::Vector3d centre = box_centre(coarse);
  for (Eigen::Vector3d& point : points) point -= centre;
  const Centreline axis(std::move(points), radius);
  const int cells = static_cast<int>(std::ceil(std::sqrt(surface_area(coarse) / 6) / organ.edge));
  TriangleMesh mesh = tube(organ, axis, cells);
  compute_normals(mesh);
  return {std::move(mesh), axis};
}

OrganShape flat_card(const OrganConfiguration& organ) {
  const auto cols = static_cast<std::uint32_t>(std::ceil(organ.width / organ.edge));
  const auto rows = static_cast<std::uint32_t>(std::ceil(organ.height / organ.edge));
  TriangleMesh mesh;
  for (std::uint32_t row = 0; row <= rows; ++row) {
    for (std::uint32_t col = 0; col <= cols; ++col) {
      mesh.vertices.emplace_back(organ.width * (static_cast<double>(col) / cols - 0.5),
                                 organ.height * (static_cast<double>(row) / rows - 0.5), 0);
      if (row == rows || col == cols) continue;
      const std::uint32_t corner = row * (cols + 1) + col;
      const std::uint32_t above = corner + cols + 1;
      mesh.triangles.push_back({corner, corner + 1, above + 1});
      mesh.triangles.push_back({corner, above + 1, above});
    }
  }
  compute_normals(mesh);
  std::vector<Eigen::Vector3d> axis;
  for (std::size_t i = 0; i < kAxisPoints; ++i) {
    axis.emplace_back(organ.width * (static_cast<double>(i) / (kAxisPoints - 1) - 0.5), 0, 0);
  }
  return {std::move(mesh), Centreline(std::move(axis), [](std::size_t, double) { return 0.0; })};
}

}  // namespace gastronaut

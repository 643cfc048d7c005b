// organ_from_file: VTK legacy PolyData to a fine, smooth, centred mesh with its axis.
#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <numbers>

#include "virtual_rig/organ_shape.hpp"

namespace gastronaut {
namespace {

constexpr double kMillimetre = 1e-3;
constexpr std::size_t kAxisPoints = 49;
// Slices at the very ends are caps, not tube.
constexpr double kAxisMargin = 0.03;

TriangleMesh read_vtk(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw ConfigurationError(path + ": cannot be opened; is organ.mesh right?");
  const auto fail = [&path](const std::string& problem) -> ConfigurationError {
    return ConfigurationError(path + ": " + problem +
                              "; wanted is VTK legacy PolyData in ASCII, triangles, millimetres");
  };
  TriangleMesh mesh;
  constexpr std::size_t kMostElements = 5'000'000;
  for (std::string word; file >> word;) {
    std::size_t count = 0;
    if (word == "POINTS") {
      if (!(file >> count >> word) || count > kMostElements) throw fail("bad POINTS line");
      mesh.vertices.resize(count);
      for (Eigen::Vector3f& vertex : mesh.vertices) {
        if (!(file >> vertex.x() >> vertex.y() >> vertex.z())) throw fail("points end early");
        vertex *= static_cast<float>(kMillimetre);
      }
    } else if (word == "POLYGONS") {
      if (!(file >> count >> word) || count > kMostElements) throw fail("bad POLYGONS line");
      mesh.triangles.resize(count);
      for (Triangle& t : mesh.triangles) {
        int corners = 0;
        if (!(file >> corners >> t[0] >> t[1] >> t[2])) throw fail("polygons end early");
        if (corners != 3) throw fail("a polygon is not a triangle");
        if (std::max({t[0], t[1], t[2]}) >= mesh.vertices.size()) {
          throw fail("a triangle names a point that is not there");
        }
      }
    }
  }
  if (mesh.triangles.empty()) throw fail("no triangles");
  return mesh;
}

void align_and_centre(TriangleMesh& mesh) {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& vertex : mesh.vertices) mean += vertex.cast<double>();
  mean /= static_cast<double>(mesh.vertices.size());
  Eigen::Matrix3d spread = Eigen::Matrix3d::Zero();
  for (const auto& vertex : mesh.vertices) {
    const Eigen::Vector3d from = vertex.cast<double>() - mean;
    spread += from * from.transpose();
  }
  // Eigenvalues ascend: the last direction is the longest.
  const Eigen::Matrix3d directions =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(spread).eigenvectors();
  Eigen::Matrix3d rotation;
  rotation.row(0) = directions.col(2).transpose();
  rotation.row(1) = directions.col(1).transpose();
  rotation.row(2) = rotation.row(0).cross(rotation.row(1));
  Eigen::Vector3d low = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector3d high = -low;
  for (auto& vertex : mesh.vertices) {
    const Eigen::Vector3d turned = rotation * (vertex.cast<double>() - mean);
    low = low.cwiseMin(turned);
    high = high.cwiseMax(turned);
    vertex = turned.cast<float>();
  }
  for (auto& vertex : mesh.vertices) vertex -= ((low + high) / 2).cast<float>();
  double volume = 0;
  for (const Triangle& t : mesh.triangles) {
    volume += static_cast<double>(
        mesh.vertices[t[0]].dot(mesh.vertices[t[1]].cross(mesh.vertices[t[2]])));
  }
  if (volume > 0) {
    for (Triangle& t : mesh.triangles) std::swap(t[1], t[2]);
  }
}

double mean_edge(const TriangleMesh& mesh) {
  double sum = 0;
  for (const Triangle& t : mesh.triangles) {
    sum += static_cast<double>((mesh.vertices[t[0]] - mesh.vertices[t[1]]).norm());
  }
  return sum / static_cast<double>(mesh.triangles.size());
}

// One step of Loop's subdivision (Loop 1987): four triangles for one, and smoother.
TriangleMesh subdivide(const TriangleMesh& mesh) {
  struct Edge {
    std::uint32_t middle = 0;
    std::vector<std::uint32_t> opposite;
  };
  std::map<std::pair<std::uint32_t, std::uint32_t>, Edge> edges;
  // Not std::minmax: that would return references to the copies a and b.
  const auto key = [](std::uint32_t a, std::uint32_t b) {
    return std::pair(std::min(a, b), std::max(a, b));
  };
  std::vector<Eigen::Vector3f> neighbour_sum(mesh.vertices.size(), Eigen::Vector3f::Zero());
  std::vector<int> neighbours(mesh.vertices.size(), 0);
  for (const Triangle& t : mesh.triangles) {
    for (std::size_t i = 0; i < 3; ++i) {
      edges[key(t[i], t[(i + 1) % 3])].opposite.push_back(t[(i + 2) % 3]);
    }
  }
  TriangleMesh fine;
  fine.vertices.resize(mesh.vertices.size());
  for (auto& [ends, edge] : edges) {
    const Eigen::Vector3f& a = mesh.vertices[ends.first];
    const Eigen::Vector3f& b = mesh.vertices[ends.second];
    neighbour_sum[ends.first] += b;
    neighbour_sum[ends.second] += a;
    ++neighbours[ends.first];
    ++neighbours[ends.second];
    edge.middle = static_cast<std::uint32_t>(fine.vertices.size());
    Eigen::Vector3f middle = (a + b) / 2;
    if (edge.opposite.size() == 2) {
      middle = 0.375F * (a + b) +
               0.125F * (mesh.vertices[edge.opposite[0]] + mesh.vertices[edge.opposite[1]]);
    }
    fine.vertices.push_back(middle);
  }
  for (std::size_t i = 0; i < mesh.vertices.size(); ++i) {
    const int n = neighbours[i];
    const float weight = n == 3 ? 3.0F / 16 : 3.0F / (8 * static_cast<float>(std::max(n, 1)));
    fine.vertices[i] =
        (1 - static_cast<float>(n) * weight) * mesh.vertices[i] + weight * neighbour_sum[i];
  }
  for (const Triangle& t : mesh.triangles) {
    const std::uint32_t ab = edges[key(t[0], t[1])].middle;
    const std::uint32_t bc = edges[key(t[1], t[2])].middle;
    const std::uint32_t ca = edges[key(t[2], t[0])].middle;
    fine.triangles.push_back({t[0], ab, ca});
    fine.triangles.push_back({ab, t[1], bc});
    fine.triangles.push_back({ca, bc, t[2]});
    fine.triangles.push_back({ab, bc, ca});
  }
  return fine;
}

// Distance along `direction` to the nearest wall, brute force (Moeller and Trumbore 1997).
double distance_to_wall(const TriangleMesh& mesh, const Eigen::Vector3d& origin,
                        const Eigen::Vector3d& direction) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const Triangle& t : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[t[0]].cast<double>();
    const Eigen::Vector3d ab = mesh.vertices[t[1]].cast<double>() - a;
    const Eigen::Vector3d ac = mesh.vertices[t[2]].cast<double>() - a;
    const Eigen::Vector3d p = direction.cross(ac);
    const double determinant = ab.dot(p);
    if (determinant == 0) continue;
    const Eigen::Vector3d from = origin - a;
    const Eigen::Vector3d q = from.cross(ab);
    const double u = from.dot(p) / determinant;
    const double v = direction.dot(q) / determinant;
    const double distance = ac.dot(q) / determinant;
    if (u >= 0 && v >= 0 && u + v <= 1 && distance > 0) nearest = std::min(nearest, distance);
  }
  return nearest;
}

// Middles of the cavity in slices across its longest direction, smoothed.
std::vector<Eigen::Vector3d> slice_middles(const TriangleMesh& mesh) {
  double low = 0;
  double high = 0;
  for (const auto& vertex : mesh.vertices) {
    low = std::min(low, static_cast<double>(vertex.x()));
    high = std::max(high, static_cast<double>(vertex.x()));
  }
  std::vector<Eigen::Vector3d> middles;
  for (std::size_t i = 0; i < kAxisPoints; ++i) {
    const double fraction = static_cast<double>(i) / (kAxisPoints - 1);
    const double x = low + (high - low) * (kAxisMargin + (1 - 2 * kAxisMargin) * fraction);
    // Mean of the outline, weighted by its length.
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    double weight = 0;
    for (const Triangle& t : mesh.triangles) {
      std::vector<Eigen::Vector3d> crossing;
      for (std::size_t k = 0; k < 3; ++k) {
        const Eigen::Vector3d a = mesh.vertices[t[k]].cast<double>();
        const Eigen::Vector3d b = mesh.vertices[t[(k + 1) % 3]].cast<double>();
        if ((a.x() < x) != (b.x() < x))
          crossing.push_back(a + (x - a.x()) / (b.x() - a.x()) * (b - a));
      }
      if (crossing.size() != 2) continue;
      const double length = (crossing[1] - crossing[0]).norm();
      sum += length * (crossing[0] + crossing[1]) / 2;
      weight += length;
    }
    if (weight > 0) middles.emplace_back(sum / weight);
  }
  constexpr int kSmoothings = 20;
  for (int pass = 0; pass < kSmoothings; ++pass) {
    std::vector<Eigen::Vector3d> smooth = middles;
    for (std::size_t i = 1; i + 1 < middles.size(); ++i) {
      smooth[i] = (middles[i - 1] + 2 * middles[i] + middles[i + 1]) / 4;
    }
    middles = std::move(smooth);
  }
  return middles;
}

}  // namespace

OrganShape organ_from_file(const OrganConfiguration& organ) {
  TriangleMesh mesh = read_vtk(organ.mesh);
  for (auto& vertex : mesh.vertices) vertex *= static_cast<float>(organ.mesh_scale);
  align_and_centre(mesh);
  std::vector<Eigen::Vector3d> points = slice_middles(mesh);
  // The cavity's radius is measured from a provisional axis with the same frames.
  const Centreline frames(points, [](std::size_t, double) { return 1.0; });
  const double last = static_cast<double>(points.size() - 1);
  const Centreline axis(points, [&](std::size_t point, double angle) {
    const Centreline::Frame frame = frames.frame(static_cast<double>(point) / last);
    const double distance = distance_to_wall(mesh, frame.centre, frame.direction(angle));
    return std::isfinite(distance) ? distance : 0.0;
  });
  while (mean_edge(mesh) > organ.edge * std::numbers::sqrt2) mesh = subdivide(mesh);
  compute_normals(mesh);
  return {std::move(mesh), axis};
}

}  // namespace gastronaut

// A sphere of triangles, the surface whose distance everybody knows.
#pragma once

#include <cmath>
#include <fstream>
#include <numbers>
#include <string>

#include "evaluate/true_surface.hpp"

namespace gastronaut::evaluation {

constexpr double kSphereRadius = 0.04;  // metres
constexpr int kSphereRings = 90;
// How deep a triangle's middle lies below the sphere: sagitta of a cell's diagonal.
inline const double kSphereSagitta =
    kSphereRadius * (1 - std::cos(std::numbers::pi / kSphereRings / std::numbers::sqrt2));

inline TriangleMesh sphere_mesh() {
  constexpr std::uint32_t kAround = 2 * kSphereRings;
  TriangleMesh mesh;
  for (int ring = 0; ring <= kSphereRings; ++ring) {
    const double polar = std::numbers::pi * ring / kSphereRings;
    for (std::uint32_t i = 0; i < kAround; ++i) {
      const double angle = 2 * std::numbers::pi * i / kAround;
      mesh.vertices.push_back(kSphereRadius * Eigen::Vector3d(std::sin(polar) * std::cos(angle),
                                                              std::sin(polar) * std::sin(angle),
                                                              std::cos(polar)));
    }
  }
  for (std::uint32_t ring = 0; ring < kSphereRings; ++ring) {
    for (std::uint32_t i = 0; i < kAround; ++i) {
      const std::uint32_t a = ring * kAround + i;
      const std::uint32_t b = ring * kAround + (i + 1) % kAround;
      mesh.triangles.push_back({a, a + kAround, b});
      mesh.triangles.push_back({b, a + kAround, b + kAround});
    }
  }
  return mesh;
}

inline void write_ascii_ply(const std::string& path, const TriangleMesh& mesh) {
  std::ofstream file(path);
  file.precision(17);
  file << "ply\nformat ascii 1.0\nelement vertex " << mesh.vertices.size()
       << "\nproperty float x\nproperty float y\nproperty float z\nelement face "
       << mesh.triangles.size() << "\nproperty list uchar int vertex_indices\nend_header\n";
  for (const auto& vertex : mesh.vertices) file << vertex.transpose() << "\n";
  for (const auto& [a, b, c] : mesh.triangles) file << "3 " << a << " " << b << " " << c << "\n";
}

}  // namespace gastronaut::evaluation

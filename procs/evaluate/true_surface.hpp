// The true surface as triangles: read from a file, and asked for the nearest point and for what
// hides what.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

namespace gastronaut::evaluation {

struct TriangleMesh {
  std::vector<Eigen::Vector3d> vertices;                // metres
  std::vector<std::array<std::uint32_t, 3>> triangles;  // indices of vertices
};

// A PLY file, ASCII or little endian; faces with more corners become fans. Throws
// std::runtime_error that says what is wrong with the file.
TriangleMesh read_surface(const std::string& path);

// Points spread evenly over the area, the same each time.
std::vector<Eigen::Vector3d> sample_surface(const TriangleMesh& mesh, std::size_t count);

// Nearest point of a triangle (Ericson, "Real-Time Collision Detection", section 5.1.5).
Eigen::Vector3d nearest_on_triangle(const Eigen::Vector3d& point, const Eigen::Vector3d& a,
                                    const Eigen::Vector3d& b, const Eigen::Vector3d& c);

// Safe from several threads.
class TrueSurface {
 public:
  // Throws std::runtime_error when Embree cannot start, std::invalid_argument without triangles.
  explicit TrueSurface(TriangleMesh mesh);
  ~TrueSurface();
  TrueSurface(const TrueSurface&) = delete;
  TrueSurface& operator=(const TrueSurface&) = delete;

  const TriangleMesh& mesh() const { return mesh_; }
  // Exact but for the rounding of doubles; of two as near, that of the first triangle.
  Eigen::Vector3d nearest(const Eigen::Vector3d& point) const;
  // Whether nothing lies between the eye and a point of the surface.
  bool sees(const Eigen::Vector3d& eye, const Eigen::Vector3d& point) const;

 private:
  struct Tree;
  TriangleMesh mesh_;
  std::unique_ptr<Tree> tree_;
};

}  // namespace gastronaut::evaluation

// A hollow organ as a triangle mesh whose wall can move: procedural stomachs (a bent tube with
// rugae and bumps, closed or cut open) or a mesh from a file, displaced the same way.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "virtual_rig/centreline.hpp"
#include "virtual_rig/scenario.hpp"

namespace gastronaut {

using Triangle = std::array<std::uint32_t, 3>;

// Rig frame, metres. Normals are unit and point into the cavity.
struct TriangleMesh {
  std::vector<Eigen::Vector3f> vertices;
  std::vector<Eigen::Vector3f> normals;
  std::vector<Triangle> triangles;  // anticlockwise as seen from the cavity
};

// Area-weighted normals of the vertices.
void compute_normals(TriangleMesh& mesh);

struct OrganShape;

class Organ {
 public:
  // Throws ConfigurationError when organ.mesh cannot be read.
  explicit Organ(const OrganConfiguration& organ);

  const OrganConfiguration& configuration() const { return organ_; }
  const Centreline& centreline() const { return centreline_; }
  // The wall at rest: what texture is painted on, and the true surface.
  const TriangleMesh& rest() const { return rest_; }
  bool moves() const { return organ_.peristalsis.amplitude > 0; }
  // Vertices and normals of the wall at `time` (seconds) into `mesh`, which began as rest().
  void deform(double time, TriangleMesh& mesh) const;

 private:
  Organ(const OrganConfiguration& organ, OrganShape shape);

  OrganConfiguration organ_;
  Centreline centreline_;
  TriangleMesh rest_;
  // One a vertex, for the contraction wave: metres along the axis, and the unit direction to the
  // axis times what of the wave arrives (it fades at the closed ends).
  std::vector<float> along_;
  std::vector<Eigen::Vector3f> inwards_;
};

// Binary PLY of vertices and triangles. Throws std::runtime_error when it cannot be written.
void write_ply(const std::string& path, const TriangleMesh& mesh);

}  // namespace gastronaut

// A triangle mesh of a map's surfels, for figures and for programs that know no surfels.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "surfels/surfel_store.hpp"

namespace gastronaut {

// The surfels' frame. Each vertex belongs to a triangle; no triangle is degenerate.
struct TriangleMesh {
  std::vector<Eigen::Vector3f> vertices;  // metres
  std::vector<Eigen::Vector3f> normals;   // one a vertex: unit, out of the tissue
  std::vector<Eigen::Vector3f> colours;   // one a vertex: red, green, blue, 0 to 255
  // Indices of vertices, counterclockwise seen from where the normals point.
  std::vector<std::array<std::int32_t, 3>> triangles;
};

// The zero set of f(p) = sum w_i n_i . (p - c_i) / sum w_i over surfels with centres c_i and
// normals n_i (implicit moving least squares; Kolluri, ACM TALG 2008), by marching tetrahedra. w_i
// is positive up to two radii (at least one voxel) from c_i in the surfel's plane and two voxels
// off it. Where a surface is that far from any surfel there is no mesh: holes wider than four
// radii stay holes, and so stay surfaces apart that are four voxels apart. Surfaces less than about
// a voxel apart cannot be told from each other: opposite ones leave a hole there.
//
// Time and memory grow with the number of surfels and with their area in voxels, not with the
// space between: 3 kB for each 4 x 4 x 4 corners of the grid of which one is near a surfel, then
// the mesh: some 200 bytes a surfel in all for a surface seen once. Same surfels, same bytes.
//
// `voxel` is the edge of the grid's cubes in metres; 0: 1.25 median radii. Throws
// std::invalid_argument for one that is negative, not finite, or below half the median
// radius, which would show nothing more, and for surfels four million voxels from the origin.
TriangleMesh triangulate(std::span<const Surfel> surfels, double voxel = 0);

// PLY, binary little endian: vertices float x y z nx ny nz, uchar red green blue; faces
// uchar 3, int32 x 3. Metres. Writes path + ".partial" and renames it when it is
// complete; throws std::runtime_error, saying why, when that fails.
void export_mesh(const std::string& path, const TriangleMesh& mesh);

}  // namespace gastronaut

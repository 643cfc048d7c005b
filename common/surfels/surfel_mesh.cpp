#include "surfels/surfel_mesh.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <deque>
#include <fstream>
#include <stdexcept>
#include <unordered_map>

#include "process/whole_file.hpp"
#include "surfels/ply_file.hpp"

namespace gastronaut {
namespace {

// Lengths without a unit in their name are in voxels, and so are positions.

constexpr double kMedianRadiiPerVoxel = 1.25;
constexpr double kFinestVoxel = 0.5;  // of the median radius
// Radii in its plane that a surfel supports. They overlap by far: it lies 0.7 radii to the next.
constexpr double kSupportRadii = 2;
constexpr double kLargestSupport = 32;  // whatever the radius, so that no surfel fills the grid
// Off its plane: all corners of a tetrahedron that the surface cuts, up to sqrt(3), with a margin.
constexpr double kBand = 2;
// Both ends of an edge see the surface where the vertex is to be, within this. Else they see two
// surfaces, and there is none between.
constexpr float kSameSurface = 0.5F;
constexpr float kLeastAgreement = 0.5F;  // length of the mean of unit normals: 60 degrees
// f is kept this far from zero at corners, so that no two edges have their vertices in one place.
constexpr float kLeastDistance = 0.01F;

constexpr int kBlockEdge = 4;
constexpr int kBlockBits = 21;  // of a coordinate in a key
constexpr double kReach = kBlockEdge * (1 << (kBlockBits - 1)) - kLargestSupport - kBlockEdge;

// Of the grid. Sums over surfels first, then means.
struct Corner {
  float weight = 0;  // 0: no surfel is near
  float distance = 0;
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();
  Eigen::Vector3f colour = Eigen::Vector3f::Zero();
  // Of the edges from here to the corners with one or more coordinates greater by 1, those with a
  // vertex: bit `step - 1`, where bit k of step is axis k. Their vertices have successive indices.
  std::int32_t first_vertex = 0;
  std::uint32_t crossed = 0;

  bool is_supported() const { return weight > 0; }
};

struct Block {
  Eigen::Vector3i base;  // of its corners the one with the least coordinates
  std::array<Corner, kBlockEdge * kBlockEdge * kBlockEdge> corners;

  Corner& at(const Eigen::Vector3i& local) {
    return corners[static_cast<std::size_t>((local.z() * kBlockEdge + local.y()) * kBlockEdge +
                                            local.x())];
  }
};

Eigen::Vector3i step_of(std::uint32_t bits) {
  return {static_cast<int>(bits & 1U), static_cast<int>(bits >> 1 & 1U),
          static_cast<int>(bits >> 2 & 1U)};
}

// Blocks in the order in which they were first needed.
class Grid {
 public:
  Corner& at(const Eigen::Vector3i& corner) {
    const Eigen::Vector3i block = corner.unaryExpr([](int c) { return c >> kBlockBitsOfEdge; });
    if (latest_ == nullptr || block * kBlockEdge != latest_->base) {
      const auto [place, is_new] = by_key_.try_emplace(key_of(block), nullptr);
      if (is_new) {
        place->second = &blocks_.emplace_back();
        place->second->base = block * kBlockEdge;
      }
      latest_ = place->second;
    }
    return latest_->at(corner - latest_->base);
  }

  std::deque<Block>& blocks() { return blocks_; }

  // visit(position of the corner, cube), for each corner with support, in one order for ever:
  // cube[bits] is the corner at step_of(bits) from it, nullptr where there is no support.
  template <class Visit>
  void for_each_cube(const Visit& visit) {
    for (Block& block : blocks_) {
      std::array<Block*, 8> blocks;
      for (std::uint32_t bits = 0; bits < 8; ++bits) {
        blocks[bits] = find(block.base / kBlockEdge + step_of(bits));
      }
      std::array<Corner*, 8> cube;
      Eigen::Vector3i local;
      for (local.z() = 0; local.z() < kBlockEdge; ++local.z()) {
        for (local.y() = 0; local.y() < kBlockEdge; ++local.y()) {
          for (local.x() = 0; local.x() < kBlockEdge; ++local.x()) {
            if (!block.at(local).is_supported()) continue;
            for (std::uint32_t bits = 0; bits < 8; ++bits) {
              const Eigen::Vector3i there = local + step_of(bits);
              const Eigen::Vector3i over = there / kBlockEdge;
              Block* owner =
                  blocks[static_cast<std::size_t>(over.x() | over.y() << 1 | over.z() << 2)];
              Corner* corner = owner == nullptr ? nullptr : &owner->at(there - over * kBlockEdge);
              cube[bits] = corner != nullptr && corner->is_supported() ? corner : nullptr;
            }
            visit(Eigen::Vector3i(block.base + local), cube);
          }
        }
      }
    }
  }

 private:
  static constexpr int kBlockBitsOfEdge = std::countr_zero(static_cast<unsigned>(kBlockEdge));

  static std::uint64_t key_of(const Eigen::Vector3i& block) {
    std::uint64_t key = 0;
    for (const int c : block) {
      key = key << kBlockBits | static_cast<std::uint64_t>(c + (1 << (kBlockBits - 1)));
    }
    return key;
  }
  Block* find(const Eigen::Vector3i& block) const {
    const auto place = by_key_.find(key_of(block));
    return place == by_key_.end() ? nullptr : place->second;
  }

  std::deque<Block> blocks_;
  std::unordered_map<std::uint64_t, Block*> by_key_;  // looked up, never walked
  Block* latest_ = nullptr;
};

struct Disc {
  Eigen::Vector3d centre;
  Eigen::Vector3d normal;
  double support;
  Eigen::Vector3f colour;
};

int first_from(double least) { return static_cast<int>(std::ceil(least)); }

// Adds the disc to all corners in the flat cylinder that it supports.
void add(const Disc& disc, Grid& grid) {
  const Eigen::Vector3d& c = disc.centre;
  const Eigen::Vector3d& n = disc.normal;
  const double support2 = disc.support * disc.support;
  Eigen::Index across = 0;
  n.cwiseAbs().maxCoeff(&across);
  const Eigen::Index u = (across + 1) % 3;
  const Eigen::Index v = (across + 2) % 3;
  const auto extent = [&](Eigen::Index axis) {
    return disc.support * std::sqrt(std::max(0.0, 1 - n[axis] * n[axis])) +
           kBand * std::abs(n[axis]);
  };
  const double column = kBand / std::abs(n[across]);
  Eigen::Vector3i p;
  for (p[u] = first_from(c[u] - extent(u)); p[u] <= c[u] + extent(u); ++p[u]) {
    for (p[v] = first_from(c[v] - extent(v)); p[v] <= c[v] + extent(v); ++p[v]) {
      const double middle = c[across] - (n[u] * (p[u] - c[u]) + n[v] * (p[v] - c[v])) / n[across];
      for (p[across] = first_from(middle - column); p[across] <= middle + column; ++p[across]) {
        const Eigen::Vector3d offset = p.cast<double>() - c;
        const double distance = n.dot(offset);
        const double along = 1 - (offset.squaredNorm() - distance * distance) / support2;
        const double off = 1 - distance * distance / (kBand * kBand);
        if (along <= 0 || off <= 0) continue;
        // Falls faster off the plane, so that the nearer of two surfaces counts.
        const auto weight = static_cast<float>(along * along * off * off * off * off);
        Corner& corner = grid.at(p);
        corner.weight += weight;
        corner.distance += weight * static_cast<float>(distance);
        corner.normal += weight * n.cast<float>();
        corner.colour += weight * disc.colour;
      }
    }
  }
}

void sums_to_means(Grid& grid) {
  for (Block& block : grid.blocks()) {
    for (Corner& corner : block.corners) {
      if (!corner.is_supported()) continue;
      corner.distance /= corner.weight;
      corner.distance =
          std::copysign(std::max(std::abs(corner.distance), kLeastDistance), corner.distance);
      corner.normal /= corner.weight;
      corner.colour /= corner.weight;
    }
  }
}

// On the edges that the surface cuts and both of whose ends see it there.
void make_vertices(Grid& grid, double voxel, TriangleMesh& mesh) {
  grid.for_each_cube([&](const Eigen::Vector3i& position, const std::array<Corner*, 8>& cube) {
    Corner& a = *cube[0];
    a.first_vertex = static_cast<std::int32_t>(mesh.vertices.size());
    for (std::uint32_t bits = 1; bits < 8; ++bits) {
      if (cube[bits] == nullptr) continue;
      const Corner& b = *cube[bits];
      if ((a.distance < 0) == (b.distance < 0)) continue;
      const Eigen::Vector3f edge = step_of(bits).cast<float>();
      const float t = a.distance / (a.distance - b.distance);
      const float seen_from_a = a.distance + t * a.normal.dot(edge);
      const float seen_from_b = b.distance - (1 - t) * b.normal.dot(edge);
      const Eigen::Vector3f normal = a.normal + t * (b.normal - a.normal);
      const float agreement = normal.norm();
      if (std::max(std::abs(seen_from_a), std::abs(seen_from_b)) > kSameSurface ||
          agreement < kLeastAgreement) {
        continue;
      }
      a.crossed |= 1U << (bits - 1);
      mesh.vertices.emplace_back(
          (voxel * (position.cast<double>() + (t * edge).cast<double>())).cast<float>());
      mesh.normals.emplace_back(normal / agreement);
      mesh.colours.emplace_back(a.colour + t * (b.colour - a.colour));
    }
  });
}

// Of the edge between two of a cube's corners one of which is the other and further steps; -1:
// none.
std::int32_t vertex_between(const std::array<Corner*, 8>& cube, std::uint32_t a, std::uint32_t b) {
  const Corner& from = *cube[std::min(a, b)];
  const std::uint32_t bit = 1U << ((a ^ b) - 1);
  return (from.crossed & bit) == 0 ? -1
                                   : from.first_vertex + std::popcount(from.crossed & (bit - 1));
}

void add_triangle(std::array<std::int32_t, 3> triangle, bool is_reversed, TriangleMesh& mesh) {
  if (std::min({triangle[0], triangle[1], triangle[2]}) < 0) return;
  if (is_reversed) std::swap(triangle[1], triangle[2]);
  const auto of = [&](const std::vector<Eigen::Vector3f>& array, std::size_t k) {
    return array[static_cast<std::size_t>(triangle[k])];
  };
  const Eigen::Vector3f face = (of(mesh.vertices, 1) - of(mesh.vertices, 0))
                                   .cross(of(mesh.vertices, 2) - of(mesh.vertices, 0));
  const Eigen::Vector3f normal = of(mesh.normals, 0) + of(mesh.normals, 1) + of(mesh.normals, 2);
  if (face.dot(normal) > 0) mesh.triangles.push_back(triangle);
}

// Corners in an order in which (t1 - t0) x (t2 - t0) . (t3 - t0) > 0, else is_reversed.
// For any k, (k, k ^ 1, k ^ 2, k ^ 3) is an even permutation of (0, 1, 2, 3), so what holds for
// corner 0 holds for all.
void cut_tetrahedron(const std::array<Corner*, 8>& cube,
                     const std::array<std::uint32_t, 4>& corners, bool is_reversed,
                     TriangleMesh& mesh) {
  std::uint32_t inside = 0;  // bit k: corner k is behind the surface
  for (std::uint32_t k = 0; k < 4; ++k) {
    if (cube[corners[k]] == nullptr) return;
    if (cube[corners[k]]->distance < 0) inside |= 1U << k;
  }
  const auto vertex = [&](std::uint32_t a, std::uint32_t b) {
    return vertex_between(cube, corners[a], corners[b]);
  };
  constexpr std::uint32_t kAll = 15;
  if (std::popcount(inside) == 2) {
    const auto a = static_cast<std::uint32_t>(std::countr_zero(inside));
    // The three others in the same sense of rotation, the one behind the surface first.
    const std::uint32_t turn =
        a ^ static_cast<std::uint32_t>(std::countr_zero(inside & (inside - 1)));
    const std::uint32_t b = a ^ turn;
    const std::uint32_t c = a ^ (turn % 3 + 1);
    const std::uint32_t d = a ^ ((turn + 1) % 3 + 1);
    add_triangle({vertex(a, c), vertex(a, d), vertex(b, d)}, is_reversed, mesh);
    add_triangle({vertex(a, c), vertex(b, d), vertex(b, c)}, is_reversed, mesh);
  } else if (inside != 0 && inside != kAll) {
    const bool is_one = std::popcount(inside) == 1;
    const auto k = static_cast<std::uint32_t>(std::countr_zero(is_one ? inside : kAll ^ inside));
    add_triangle({vertex(k, k ^ 1), vertex(k, k ^ 2), vertex(k, k ^ 3)}, is_reversed == is_one,
                 mesh);
  }
}

// Each cube is cut into the six tetrahedra along the ways from its least to its greatest corner,
// one axis after the other, so that neighbours cut the face between them alike.
void make_triangles(Grid& grid, TriangleMesh& mesh) {
  grid.for_each_cube([&](const Eigen::Vector3i&, const std::array<Corner*, 8>& cube) {
    for (std::uint32_t first = 0; first < 3; ++first) {
      for (std::uint32_t turn = 1; turn <= 2; ++turn) {
        const std::uint32_t one = 1U << first;
        const std::uint32_t two = one | 1U << (first + turn) % 3;
        cut_tetrahedron(cube, {0, one, two, 7}, turn == 2, mesh);
      }
    }
  });
}

void remove_unused_vertices(TriangleMesh& mesh) {
  std::vector<std::int32_t> index(mesh.vertices.size(), -1);
  for (const auto& triangle : mesh.triangles) {
    for (const std::int32_t k : triangle) index[static_cast<std::size_t>(k)] = 0;
  }
  std::size_t used = 0;
  for (std::size_t k = 0; k < index.size(); ++k) {
    if (index[k] < 0) continue;
    mesh.vertices[used] = mesh.vertices[k];
    mesh.normals[used] = mesh.normals[k];
    mesh.colours[used] = mesh.colours[k];
    index[k] = static_cast<std::int32_t>(used++);
  }
  mesh.vertices.resize(used);
  mesh.normals.resize(used);
  mesh.colours.resize(used);
  for (auto& triangle : mesh.triangles) {
    for (std::int32_t& k : triangle) k = index[static_cast<std::size_t>(k)];
  }
}

double median_radius(std::span<const Surfel> surfels) {
  std::vector<float> radii;
  radii.reserve(surfels.size());
  for (const Surfel& surfel : surfels) radii.push_back(surfel.radius);
  const auto middle = radii.begin() + static_cast<std::ptrdiff_t>(radii.size() / 2);
  std::nth_element(radii.begin(), middle, radii.end());
  return static_cast<double>(*middle);
}

}  // namespace

TriangleMesh triangulate(std::span<const Surfel> surfels, double voxel) {
  if (surfels.empty()) return {};
  const double median = median_radius(surfels);
  if (voxel == 0) voxel = kMedianRadiiPerVoxel * median;
  if (!(voxel >= kFinestVoxel * median) || !std::isfinite(voxel)) {
    throw std::invalid_argument("surfel mesh: a voxel of " + std::to_string(voxel) +
                                " m is too small for surfels with a median radius of " +
                                std::to_string(median) + " m; give half of that at least");
  }

  Grid grid;
  for (const Surfel& surfel : surfels) {
    const Disc disc = {surfel.position.cast<double>() / voxel,
                       surfel.normal.cast<double>().normalized(),
                       std::clamp(kSupportRadii * static_cast<double>(surfel.radius) / voxel, 1.0,
                                  kLargestSupport),
                       {static_cast<float>(surfel.colour[0]), static_cast<float>(surfel.colour[1]),
                        static_cast<float>(surfel.colour[2])}};
    if (!(disc.centre.cwiseAbs().maxCoeff() < kReach)) {
      throw std::invalid_argument("surfel mesh: surfels lie out of the grid's reach, one at " +
                                  std::to_string(surfel.position.norm()) +
                                  " m; give a larger voxel");
    }
    if (!disc.normal.isZero()) add(disc, grid);
  }
  sums_to_means(grid);
  TriangleMesh mesh;
  make_vertices(grid, voxel, mesh);
  make_triangles(grid, mesh);
  remove_unused_vertices(mesh);
  return mesh;
}

void export_mesh(const std::string& path, const TriangleMesh& mesh) {
  write_whole(path, [&](std::ofstream& file) {
    write_ply_head(file, "mesh of surfels, in metres", mesh.vertices.size());
    file << "element face " << mesh.triangles.size()
         << "\nproperty list uchar int vertex_indices\nend_header\n";
    for (std::size_t k = 0; k < mesh.vertices.size(); ++k) {
      std::array<std::uint8_t, 3> colour;
      for (Eigen::Index c = 0; c < 3; ++c) {
        colour[static_cast<std::size_t>(c)] =
            static_cast<std::uint8_t>(std::lround(mesh.colours[k][c]));
      }
      write_ply_vertex(file, mesh.vertices[k], mesh.normals[k], colour);
    }
    for (const auto& triangle : mesh.triangles) {
      file.put(static_cast<char>(triangle.size()));
      file.write(reinterpret_cast<const char*>(triangle.data()), sizeof triangle);
    }
  });
}

}  // namespace gastronaut

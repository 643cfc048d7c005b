#include "virtual_rig/organ.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <fstream>
#include <numbers>
#include <stdexcept>

#include "numerics/parallel.hpp"
#include "virtual_rig/gradient_noise.hpp"
#include "virtual_rig/organ_shape.hpp"

namespace gastronaut {
namespace {

constexpr std::size_t kVerticesPerChunk = 8192;

// Seeds of the noises that shape the wall.
enum Noise : std::uint32_t { kFoldWarp = 11, kFoldHeight, kBumps, kOpening };

float noise(const Eigen::Vector3f& point, double wavelength, std::uint64_t seed, Noise which,
            std::uint32_t octave = 0) {
  const auto mixed = static_cast<std::uint32_t>(seed * 0x9E3779B1u + which * 0x85EBCA77u + octave);
  return gradient_noise(point / static_cast<float>(wavelength), mixed).value;
}

// Height of the rugae at a point of the smooth wall, metres inwards: ridges that run along the
// organ, wander, split and fade.
double fold_height(const OrganConfiguration& organ, const Eigen::Vector3f& point, double angle,
                   double along) {
  if (organ.folds == 0) return 0;
  const double wander = 3.2 * static_cast<double>(noise(point, 0.028, organ.seed, kFoldWarp)) +
                        1.4 * static_cast<double>(noise(point, 0.011, organ.seed, kFoldWarp, 1));
  const double ridge = 0.5 + 0.5 * std::cos(organ.folds * angle + wander);
  const double strength = std::clamp(
      0.65 + 1.3 * static_cast<double>(noise(point, 0.024, organ.seed, kFoldHeight)), 0.0, 1.0);
  // At the closed ends the ridges would all meet in one point.
  const double fade = std::clamp(4 * along * (1 - along) * 1.6 - 0.25, 0.0, 1.0);
  return organ.fold_height * fade * strength * std::pow(ridge, 1.7);
}

double bump_height(const OrganConfiguration& organ, const Eigen::Vector3f& point) {
  struct Octave {
    double wavelength, weight;
  };
  constexpr std::array<Octave, 4> kOctaves = {
      {{0.013, 2.2}, {0.0062, 1.0}, {0.0031, 0.42}, {0.0017, 0.16}}};
  double height = 0;
  for (std::uint32_t i = 0; i < kOctaves.size(); ++i) {
    height += kOctaves[i].weight *
              static_cast<double>(noise(point, kOctaves[i].wavelength, organ.seed, kBumps, i));
  }
  return organ.bump_height * height;
}

// What lies above the cut is gone; the vertices that nothing uses any more go with it.
void cut_open(const OrganConfiguration& organ, TriangleMesh& mesh) {
  const auto removed = [&](const Triangle& t) {
    const Eigen::Vector3f middle =
        (mesh.vertices[t[0]] + mesh.vertices[t[1]] + mesh.vertices[t[2]]) / 3;
    constexpr double kRaggedness = 0.008;  // metres
    return static_cast<double>(middle.z()) >
           organ.opening_height +
               kRaggedness * static_cast<double>(noise(middle, 0.03, organ.seed, kOpening));
  };
  std::erase_if(mesh.triangles, removed);
  constexpr std::uint32_t kUnused = ~std::uint32_t{0};
  std::vector<std::uint32_t> renumbered(mesh.vertices.size(), kUnused);
  TriangleMesh kept;
  for (Triangle& triangle : mesh.triangles) {
    for (std::uint32_t& vertex : triangle) {
      if (renumbered[vertex] == kUnused) {
        renumbered[vertex] = static_cast<std::uint32_t>(kept.vertices.size());
        kept.vertices.push_back(mesh.vertices[vertex]);
      }
      vertex = renumbered[vertex];
    }
  }
  mesh.vertices = std::move(kept.vertices);
}

// A card is as plain as a card is, whatever is said of tissue.
OrganConfiguration without_tissue(OrganConfiguration organ) {
  if (organ.shape != OrganShapeKind::kCard) return organ;
  organ.folds = 0;
  organ.bump_height = organ.vessels = organ.mucus = organ.variation = 0;
  organ.peristalsis.amplitude = 0;
  organ.opened = false;
  return organ;
}

OrganShape make_shape(const OrganConfiguration& organ) {
  if (organ.shape == OrganShapeKind::kCard) return flat_card(organ);
  return organ.mesh.empty() ? procedural_stomach(organ) : organ_from_file(organ);
}

}  // namespace

void compute_normals(TriangleMesh& mesh) {
  mesh.normals.assign(mesh.vertices.size(), Eigen::Vector3f::Zero());
  for (const Triangle& t : mesh.triangles) {
    const Eigen::Vector3f& a = mesh.vertices[t[0]];
    const Eigen::Vector3f normal = (mesh.vertices[t[1]] - a).cross(mesh.vertices[t[2]] - a);
    for (const std::uint32_t vertex : t) mesh.normals[vertex] += normal;
  }
  for (Eigen::Vector3f& normal : mesh.normals) normal.normalize();
}

Organ::Organ(const OrganConfiguration& organ) : Organ(without_tissue(organ), make_shape(organ)) {}

Organ::Organ(const OrganConfiguration& organ, OrganShape shape)
    : organ_(organ), centreline_(std::move(shape.centreline)), rest_(std::move(shape.mesh)) {
  along_.resize(rest_.vertices.size());
  std::vector<Eigen::Vector3f> displaced(rest_.vertices.size());
  parallel_for_chunks(rest_.vertices.size(), kVerticesPerChunk, [&](auto begin, auto end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector3f& point = rest_.vertices[i];
      const double along = centreline_.nearest(point.cast<double>());
      const Centreline::Frame frame = centreline_.frame(along);
      const Eigen::Vector3d across = point.cast<double>() - frame.centre;
      const double angle = std::atan2(across.dot(frame.side), -across.dot(frame.up));
      const double height = fold_height(organ_, point, angle, along) + bump_height(organ_, point);
      displaced[i] = point + static_cast<float>(height) * rest_.normals[i];
    }
  });
  rest_.vertices = std::move(displaced);
  if (organ_.opened) cut_open(organ_, rest_);
  compute_normals(rest_);
  along_.resize(rest_.vertices.size());
  inwards_.resize(rest_.vertices.size());
  parallel_for_chunks(rest_.vertices.size(), kVerticesPerChunk, [&](auto begin, auto end) {
    for (std::size_t i = begin; i < end; ++i) {
      const Eigen::Vector3d point = rest_.vertices[i].cast<double>();
      const double along = centreline_.nearest(point);
      const Eigen::Vector3d inwards = centreline_.frame(along).centre - point;
      // Nothing arrives at the axis' ends, where the direction to the axis turns about.
      const double fade = std::clamp(4 * along * (1 - along) * 1.5, 0.0, 1.0);
      along_[i] = static_cast<float>(along * centreline_.length());
      inwards_[i] = (fade * inwards.normalized()).cast<float>();
    }
  });
}

void Organ::deform(double time, TriangleMesh& mesh) const {
  if (!moves()) return;
  const PeristalsisConfiguration& wave = organ_.peristalsis;
  const double waves_passed = time / wave.period;
  parallel_for_chunks(rest_.vertices.size(), kVerticesPerChunk, [&](auto begin, auto end) {
    for (std::size_t i = begin; i < end; ++i) {
      const double phase =
          2 * std::numbers::pi * (static_cast<double>(along_[i]) / wave.wavelength - waves_passed);
      const double crest = 0.5 + 0.5 * std::cos(phase);
      mesh.vertices[i] =
          rest_.vertices[i] + static_cast<float>(wave.amplitude * crest * crest) * inwards_[i];
    }
  });
  compute_normals(mesh);
}

void write_ply(const std::string& path, const TriangleMesh& mesh) {
  std::ofstream file(path, std::ios::binary);
  file << "ply\nformat binary_little_endian 1.0\ncomment metres, rig frame, wall at rest\n"
       << "element vertex " << mesh.vertices.size()
       << "\nproperty float x\nproperty float y\nproperty float z\nelement face "
       << mesh.triangles.size() << "\nproperty list uchar int vertex_indices\nend_header\n";
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    file.write(reinterpret_cast<const char*>(vertex.data()), sizeof(float) * 3);
  }
  for (const Triangle& triangle : mesh.triangles) {
    file.put(3);
    file.write(reinterpret_cast<const char*>(triangle.data()), sizeof(triangle));
  }
  file.flush();
  if (!file) throw std::runtime_error(path + ": cannot be written");
}

}  // namespace gastronaut

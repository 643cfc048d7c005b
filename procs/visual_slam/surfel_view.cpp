#include "visual_slam/surfel_view.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "numerics/parallel.hpp"

namespace gastronaut::slam {
namespace {

constexpr std::size_t kPieceSize = 1024;  // surfels projected at a time
constexpr std::size_t kBandHeight = 16;   // rows drawn at a time

// A disc in the camera frame and the pixels that it may cover.
struct Disc {
  float x, y, z;     // centre
  float nx, ny, nz;  // towards the camera
  float plane;       // normal . centre, negative
  float radius2;
  std::int32_t id;
  std::int16_t first_u, last_u, first_v, last_v;
};

struct Piece {
  std::span<const std::int32_t> ids;
  std::size_t first_disc = 0;
  std::size_t num_discs = 0;
  int first_v = 0;
  int last_v = -1;
};

struct Camera {
  Eigen::Matrix3f rotation;  // map to camera
  Eigen::Vector3f translation;
  float fx, fy, cx, cy;
  int width, height;

  explicit Camera(const ModelView& view)
      : rotation(view.map_T_camera.rotation.inverse().toRotationMatrix().cast<float>()),
        translation(view.map_T_camera.inverse().translation.cast<float>()),
        fx(static_cast<float>(view.grid.fx)),
        fy(static_cast<float>(view.grid.fy)),
        cx(static_cast<float>(view.grid.cx)),
        cy(static_cast<float>(view.grid.cy)),
        width(view.grid.width),
        height(view.grid.height) {}
};

Eigen::Vector3f normal_of(const SurfelArrays& surfels, std::size_t id) {
  return {surfels.nx[id], surfels.ny[id], surfels.nz[id]};
}

// The pixels between two coordinates, clipped; false if there are none.
bool pixels_between(float low, float high, int size, std::int16_t& first, std::int16_t& last) {
  const float limit = static_cast<float>(size - 1);
  if (!(low <= limit) || !(high >= 0)) return false;
  first = static_cast<std::int16_t>(std::ceil(std::max(low, 0.0F)));
  last = static_cast<std::int16_t>(std::floor(std::min(high, limit)));
  return first <= last;
}

// False if no pixel can see the surfel.
bool project(const SurfelArrays& surfels, std::size_t id, const Camera& camera,
             const SplatOptions& options, Disc& disc) {
  if (surfels.updated[id] < options.active_since) return false;
  const Eigen::Vector3f centre =
      camera.rotation * Eigen::Vector3f(surfels.x[id], surfels.y[id], surfels.z[id]) +
      camera.translation;
  const float radius = surfels.radius[id];
  if (!(centre.z() > radius) || !(centre.z() <= static_cast<float>(options.farthest))) return false;
  const Eigen::Vector3f normal = camera.rotation * normal_of(surfels, id);
  const float plane = normal.dot(centre);
  if (!(-plane >= static_cast<float>(options.minimum_cosine) * centre.norm())) return false;

  // Half the disc's extent along each axis, then the picture of the box around it.
  const auto extent = [radius](float n) { return radius * std::sqrt(std::max(0.0F, 1 - n * n)); };
  const float deep = extent(normal.z());
  const float nearest = centre.z() - deep;
  const float x = centre.x() / centre.z();
  const float y = centre.y() / centre.z();
  const float half_u = camera.fx * (extent(normal.x()) + std::abs(x) * deep) / nearest;
  const float half_v = camera.fy * (extent(normal.y()) + std::abs(y) * deep) / nearest;
  const float u = camera.fx * x + camera.cx;
  const float v = camera.fy * y + camera.cy;
  if (!pixels_between(u - half_u, u + half_u, camera.width, disc.first_u, disc.last_u) ||
      !pixels_between(v - half_v, v + half_v, camera.height, disc.first_v, disc.last_v)) {
    return false;
  }
  disc.x = centre.x();
  disc.y = centre.y();
  disc.z = centre.z();
  disc.nx = normal.x();
  disc.ny = normal.y();
  disc.nz = normal.z();
  disc.plane = plane;
  disc.radius2 = radius * radius;
  disc.id = static_cast<std::int32_t>(id);
  return true;
}

// Four pixels at a time in the compiler's own vectors, which every x86-64 and ARM64 has.
constexpr int kLanes = 4;
typedef float Lanes __attribute__((vector_size(kLanes * sizeof(float))));
typedef std::int32_t Integers __attribute__((vector_size(kLanes * sizeof(std::int32_t))));

template <class Vector, class Value>
Vector load(const Value* from) {
  Vector lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}

// The winner so far at each pixel of some rows; rows are padded for the last lanes.
struct Band {
  int begin, end;  // rows
  std::ptrdiff_t stride;
  std::vector<float> depth;
  std::vector<std::int32_t> id;  // -1: none

  Band(int begin_, int end_, int width)
      : begin(begin_),
        end(end_),
        stride(width + kLanes - 1),
        depth(static_cast<std::size_t>(stride * (end - begin)),
              std::numeric_limits<float>::infinity()),
        id(depth.size(), -1) {}
};

// ray_x is padded like the band's rows.
void draw(const Disc& disc, const float* ray_x, const float* ray_y, Band& band) {
  const int first_v = std::max<int>(disc.first_v, band.begin);
  const int last_v = std::min<int>(disc.last_v, band.end - 1);
  for (int v = first_v; v <= last_v; ++v) {
    const float y = ray_y[v];
    const float row_slope = disc.ny * y + disc.nz;
    for (int u = disc.first_u; u <= disc.last_u; u += kLanes) {
      const Lanes x = load<Lanes>(ray_x + u);
      const Lanes slope = disc.nx * x + row_slope;
      const Lanes depth = disc.plane / slope;
      const Lanes dx = depth * x - disc.x;
      const Lanes dy = depth * y - disc.y;
      const Lanes dz = depth - disc.z;
      const Integers inside = (slope < 0) & (dx * dx + dy * dy + dz * dz <= disc.radius2);
      float* best_depth = band.depth.data() + (v - band.begin) * band.stride + u;
      std::int32_t* best_id = band.id.data() + (v - band.begin) * band.stride + u;
      const Lanes old_depth = load<Lanes>(best_depth);
      const Integers old_id = load<Integers>(best_id);
      const Integers wins =
          inside & ((depth < old_depth) | ((depth == old_depth) & (disc.id < old_id)));
      const Lanes new_depth = wins ? depth : old_depth;
      const Integers new_id = wins ? disc.id - Integers{} : old_id;
      std::memcpy(best_depth, &new_depth, sizeof new_depth);
      std::memcpy(best_id, &new_id, sizeof new_id);
    }
  }
}

void fill(const SurfelArrays& surfels, const Camera& camera, float depth, std::int32_t winner,
          std::size_t pixel, ModelView& view) {
  const bool seen = winner >= 0;
  const auto id = static_cast<std::size_t>(winner);
  const Eigen::Vector3f normal =
      seen ? Eigen::Vector3f(camera.rotation * normal_of(surfels, id)) : Eigen::Vector3f::Zero();
  view.depth.values[pixel] = seen ? depth : 0;
  view.normal_x.values[pixel] = normal.x();
  view.normal_y.values[pixel] = normal.y();
  view.normal_z.values[pixel] = normal.z();
  view.albedo.values[pixel] = seen ? surfels.albedo[id] : -1;
  view.confidence.values[pixel] = seen ? surfels.confidence[id] : 0;
  view.surfel.values[pixel] = winner;
}

}  // namespace

void splat(const SurfelArrays& surfels, const std::vector<std::span<const std::int32_t>>& groups,
           const SplatOptions& options, ModelView& view) {
  const Camera camera(view);
  const int width = camera.width;
  for (Plane<float>* plane : {&view.depth, &view.normal_x, &view.normal_y, &view.normal_z,
                              &view.albedo, &view.confidence}) {
    if (!plane->same_size(width, camera.height)) *plane = Plane<float>(width, camera.height);
  }
  if (!view.surfel.same_size(width, camera.height)) {
    view.surfel = Plane<std::int32_t>(width, camera.height);
  }
  std::vector<float> ray_x(static_cast<std::size_t>(width + kLanes - 1));
  std::vector<float> ray_y(static_cast<std::size_t>(camera.height));
  for (std::size_t u = 0; u < ray_x.size(); ++u) {
    ray_x[u] = (static_cast<float>(u) - camera.cx) / camera.fx;
  }
  for (std::size_t v = 0; v < ray_y.size(); ++v) {
    ray_y[v] = (static_cast<float>(v) - camera.cy) / camera.fy;
  }

  std::vector<Piece> pieces;
  std::size_t most_discs = 0;
  for (const std::span<const std::int32_t> group : groups) {
    for (std::size_t begin = 0; begin < group.size(); begin += kPieceSize) {
      Piece piece;
      piece.ids = group.subspan(begin, std::min(kPieceSize, group.size() - begin));
      piece.first_disc = most_discs;
      most_discs += piece.ids.size();
      pieces.push_back(piece);
    }
  }

  std::vector<Disc> discs(most_discs);
  run_chunks(pieces.size(), [&](std::size_t number) {
    Piece& piece = pieces[number];
    piece.first_v = camera.height;
    for (const std::int32_t id : piece.ids) {
      Disc& disc = discs[piece.first_disc + piece.num_discs];
      if (!project(surfels, static_cast<std::size_t>(id), camera, options, disc)) continue;
      piece.first_v = std::min<int>(piece.first_v, disc.first_v);
      piece.last_v = std::max<int>(piece.last_v, disc.last_v);
      ++piece.num_discs;
    }
  });

  parallel_for_chunks(ray_y.size(), kBandHeight, [&](std::size_t begin, std::size_t end) {
    Band band(static_cast<int>(begin), static_cast<int>(end), width);
    for (const Piece& piece : pieces) {
      if (piece.last_v < band.begin || piece.first_v >= band.end) continue;
      for (std::size_t k = piece.first_disc; k < piece.first_disc + piece.num_discs; ++k) {
        draw(discs[k], ray_x.data(), ray_y.data(), band);
      }
    }
    for (std::size_t v = begin; v < end; ++v) {
      const std::size_t row = (v - begin) * static_cast<std::size_t>(band.stride);
      for (std::size_t u = 0; u < static_cast<std::size_t>(width); ++u) {
        fill(surfels, camera, band.depth[row + u], band.id[row + u],
             v * static_cast<std::size_t>(width) + u, view);
      }
    }
  });
}

}  // namespace gastronaut::slam

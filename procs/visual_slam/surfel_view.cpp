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
  float albedo;  // 0 where it was never seen
  float confidence;
  float knows_albedo;  // 1 or 0
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
  if (surfels.initialised[id] >= options.known_before) return false;
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
  disc.knows_albedo = surfels.albedo[id] >= 0 ? 1 : 0;
  disc.albedo = std::max(0.0F, surfels.albedo[id]);
  disc.confidence = surfels.confidence[id];
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

// What the discs of some rows add up to; rows are padded for the last lanes.
struct Band {
  int begin, end;  // rows
  std::ptrdiff_t stride;
  std::vector<float> nearest;  // depth; infinite: nothing there
  // Sums over the discs of the nearest surface, weighted by what is known of them there.
  std::vector<float> weight, depth, nx, ny, nz, albedo_weight, albedo;
  std::vector<float> closeness;  // of the disc whose id this is
  std::vector<std::int32_t> id;  // -1: none

  Band(int begin_, int end_, int width)
      : begin(begin_),
        end(end_),
        stride(width + kLanes - 1),
        nearest(static_cast<std::size_t>(stride * (end - begin)),
                std::numeric_limits<float>::infinity()),
        closeness(nearest.size()),
        id(nearest.size(), -1) {
    for (auto* sum : {&weight, &depth, &nx, &ny, &nz, &albedo_weight, &albedo}) {
      sum->resize(nearest.size());
    }
  }
};

// Where the rays of a row's pixels meet a disc.
struct Meeting {
  Lanes depth;
  Lanes distance2;  // from its centre
  Integers inside;

  Meeting(const Disc& disc, const Lanes& x, float y) {
    const Lanes slope = disc.nx * x + (disc.ny * y + disc.nz);
    depth = disc.plane / slope;
    const Lanes dx = depth * x - disc.x;
    const Lanes dy = depth * y - disc.y;
    const Lanes dz = depth - disc.z;
    distance2 = dx * dx + dy * dy + dz * dz;
    inside = (slope < 0) & (distance2 <= disc.radius2);
  }
};

// visit(meeting, index of the first lane in the band's planes). ray_x is padded like them.
template <class Visit>
void for_each_pixel(const Disc& disc, const float* ray_x, const float* ray_y, const Band& band,
                    const Visit& visit) {
  const int first_v = std::max<int>(disc.first_v, band.begin);
  const int last_v = std::min<int>(disc.last_v, band.end - 1);
  for (int v = first_v; v <= last_v; ++v) {
    for (int u = disc.first_u; u <= disc.last_u; u += kLanes) {
      visit(Meeting(disc, load<Lanes>(ray_x + u), ray_y[v]), (v - band.begin) * band.stride + u);
    }
  }
}

void find_nearest(const Disc& disc, const float* ray_x, const float* ray_y, Band& band) {
  for_each_pixel(disc, ray_x, ray_y, band, [&](const Meeting& meeting, std::ptrdiff_t at) {
    const Lanes old = load<Lanes>(band.nearest.data() + at);
    const Lanes nearest = meeting.inside & (meeting.depth < old) ? meeting.depth : old;
    std::memcpy(band.nearest.data() + at, &nearest, sizeof nearest);
  });
}

// `same_surface`: this times the nearest depth is still the nearest surface.
void add(const Disc& disc, const float* ray_x, const float* ray_y, float same_surface, Band& band) {
  for_each_pixel(disc, ray_x, ray_y, band, [&](const Meeting& meeting, std::ptrdiff_t at) {
    const Integers counts =
        meeting.inside & (meeting.depth <= same_surface * load<Lanes>(band.nearest.data() + at));
    const Lanes zero{};
    // Never nothing, so that what is met by a disc's rim alone is drawn too.
    constexpr float kRim = 1e-3F;
    const Lanes closeness = counts ? 1 + kRim - meeting.distance2 / disc.radius2 : zero;
    const Lanes weight = closeness * disc.confidence;
    const auto increase = [at](std::vector<float>& sum, const Lanes& by) {
      const Lanes now = load<Lanes>(sum.data() + at) + by;
      std::memcpy(sum.data() + at, &now, sizeof now);
    };
    increase(band.weight, weight);
    increase(band.depth, counts ? weight * meeting.depth : zero);
    increase(band.nx, weight * disc.nx);
    increase(band.ny, weight * disc.ny);
    increase(band.nz, weight * disc.nz);
    increase(band.albedo_weight, weight * disc.knows_albedo);
    increase(band.albedo, weight * disc.albedo);
    const Lanes old_closeness = load<Lanes>(band.closeness.data() + at);
    const Integers old_id = load<Integers>(band.id.data() + at);
    const Integers wins = counts & ((closeness > old_closeness) |
                                    ((closeness == old_closeness) & (disc.id < old_id)));
    const Lanes new_closeness = wins ? closeness : old_closeness;
    const Integers new_id = wins ? disc.id - Integers{} : old_id;
    std::memcpy(band.closeness.data() + at, &new_closeness, sizeof new_closeness);
    std::memcpy(band.id.data() + at, &new_id, sizeof new_id);
  });
}

void fill(const SurfelArrays& surfels, const Band& band, std::size_t from, std::size_t pixel,
          ModelView& view) {
  const std::int32_t winner = band.id[from];
  const bool seen = winner >= 0;
  Eigen::Vector3f normal = Eigen::Vector3f::Zero();
  if (seen) normal = Eigen::Vector3f(band.nx[from], band.ny[from], band.nz[from]).normalized();
  view.depth.values[pixel] = seen ? band.depth[from] / band.weight[from] : 0;
  view.normal_x.values[pixel] = normal.x();
  view.normal_y.values[pixel] = normal.y();
  view.normal_z.values[pixel] = normal.z();
  const float albedo_weight = band.albedo_weight[from];
  view.albedo.values[pixel] = albedo_weight > 0 ? band.albedo[from] / albedo_weight : -1;
  view.confidence.values[pixel] = seen ? surfels.confidence[static_cast<std::size_t>(winner)] : 0;
  view.surfel.values[pixel] = winner;
}

}  // namespace

void splat(const SurfelArrays& surfels, const std::vector<std::span<const std::int32_t>>& groups,
           const SplatOptions& options, ModelView& view) {
  const Camera camera(view);
  const int width = camera.width;
  const auto same_surface = static_cast<float>(1 + options.surface_thickness);
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
    const auto for_each_disc = [&](const auto& visit) {
      for (const Piece& piece : pieces) {
        if (piece.last_v < band.begin || piece.first_v >= band.end) continue;
        for (std::size_t k = piece.first_disc; k < piece.first_disc + piece.num_discs; ++k) {
          visit(discs[k]);
        }
      }
    };
    for_each_disc([&](const Disc& disc) { find_nearest(disc, ray_x.data(), ray_y.data(), band); });
    for_each_disc(
        [&](const Disc& disc) { add(disc, ray_x.data(), ray_y.data(), same_surface, band); });
    for (std::size_t v = begin; v < end; ++v) {
      const std::size_t row = (v - begin) * static_cast<std::size_t>(band.stride);
      for (std::size_t u = 0; u < static_cast<std::size_t>(width); ++u) {
        fill(surfels, band, row + u, v * static_cast<std::size_t>(width) + u, view);
      }
    }
  });
}

}  // namespace gastronaut::slam

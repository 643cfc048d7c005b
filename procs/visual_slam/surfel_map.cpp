#include "visual_slam/surfel_map.hpp"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <stdexcept>
#include <utility>

#include "numerics/parallel.hpp"
#include "visual_slam/surfel_view.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kMicroseconds = 1e6;  // a second
constexpr std::size_t kRowsAtATime = 8;
constexpr std::size_t kClaimsAtATime = 2048;

SurfelMapOptions checked(const SurfelMapOptions& o) {
  const bool good = o.working_distance > 0 && o.block_size > 0 && o.farthest > 0 &&
                    o.depth_gate > 0 && o.depth_gate_sigmas >= 0 && o.angle_gate > 0 &&
                    o.minimum_cosine > 0 && o.minimum_cosine < 1 && o.radius_growth >= 1 &&
                    o.merge_distance >= 0 && o.merge_thickness >= 0 && o.trusted_relative_std > 0 &&
                    o.confidence_limit >= o.stable_confidence && o.active_window > 0 &&
                    o.unseen_limit > 0 && o.least_confidence > 0 && o.reserved_surfels >= 0;
  if (!good) {
    throw std::invalid_argument(
        "surfel map: distances, gates, windows and limits must be positive, minimum_cosine below "
        "1, radius_growth at least 1, and confidence_limit at least stable_confidence");
  }
  return o;
}

// ElasticFusion's: sqrt(2) pixels, more where the surface is tilted, at most twice that.
float disc_radius(float depth, const PinholeGrid& grid, float normal_z) {
  const auto focal = static_cast<float>(std::min(grid.fx, grid.fy));
  return std::numbers::sqrt2_v<float> * depth / focal / std::max(std::abs(normal_z), 0.5F);
}

// Pixels count less towards the corners, where lenses are worst.
float pixel_weight(const PinholeGrid& grid, int u, int v) {
  constexpr double kTwiceVariance = 0.72;
  const double du = u - grid.cx;
  const double dv = v - grid.cy;
  const double most_u = std::max(grid.cx, grid.width - 1 - grid.cx);
  const double most_v = std::max(grid.cy, grid.height - 1 - grid.cy);
  const double fraction2 = (du * du + dv * dv) / (most_u * most_u + most_v * most_v);
  return static_cast<float>(std::exp(-fraction2 / kTwiceVariance));
}

Eigen::Vector3f vertex(const PinholeGrid& grid, int u, int v, float depth) {
  return depth * Eigen::Vector3f(static_cast<float>((u - grid.cx) / grid.fx),
                                 static_cast<float>((v - grid.cy) / grid.fy), 1);
}

}  // namespace

// A pixel of the frame, as a surfel would be, map frame.
struct SurfelMap::Measurement {
  Eigen::Vector3f position;
  Eigen::Vector3f normal;
  float radius;
  float albedo;
  float weight;
};

SurfelMap::SurfelMap(const SurfelMapOptions& options) : SurfelMap(options, SurfelArrays{}) {}

SurfelMap::SurfelMap(const SurfelMapOptions& options, SurfelArrays surfels)
    : options_(checked(options)),
      active_window_(std::llround(options.active_window * kMicroseconds)),
      unseen_limit_(std::llround(options.unseen_limit * kMicroseconds)),
      cosine_gate_(static_cast<float>(std::cos(options.angle_gate))),
      surfels_(std::move(surfels)),
      blocks_(options.block_size * options.working_distance) {
  surfels_.reserve(static_cast<std::size_t>(options.reserved_surfels));
  is_changed_.resize(surfels_.size());
  claim_of_.resize(surfels_.size(), -1);
  for (std::size_t index = surfels_.size(); index-- > 0;) {
    if (!surfels_.holds(index)) free_ids_.push_back(static_cast<std::int32_t>(index));
  }
  for (std::size_t index = 0; index < surfels_.size(); ++index) {
    if (!surfels_.holds(index)) continue;
    const auto id = static_cast<std::int32_t>(index);
    const Eigen::Vector3f position(surfels_.x[index], surfels_.y[index], surfels_.z[index]);
    if (!blocks_.reaches(position)) {
      throw std::invalid_argument(
          "surfel map: a surfel lies a million blocks off; is working_distance that of this map?");
    }
    blocks_.place(id, position, surfels_.radius[index], surfels_.updated[index]);
    ++size_;
    mark_changed(id);
    if (!is_stable(id)) due_[surfels_.updated[index] + unseen_limit_].push_back(id);
  }
}

bool SurfelMap::is_active(std::int32_t id, std::int64_t now) const {
  const auto index = static_cast<std::size_t>(id);
  return surfels_.holds(index) && surfels_.updated[index] >= now - active_window_;
}

bool SurfelMap::is_stable(std::int32_t id) const {
  const auto index = static_cast<std::size_t>(id);
  return surfels_.holds(index) &&
         static_cast<double>(surfels_.confidence[index]) >= options_.stable_confidence;
}

void SurfelMap::predict(const SE3& map_T_camera, const PinholeGrid& grid, std::int64_t now,
                        MapPart part, ModelView& view) const {
  SplatOptions splat_options;
  splat_options.farthest = options_.farthest * options_.working_distance;
  splat_options.minimum_cosine = options_.minimum_cosine;
  if (part == MapPart::kActive) splat_options.active_since = now - active_window_;
  if (part == MapPart::kOld) splat_options.known_before = old_before(now);
  view.map_T_camera = map_T_camera;
  view.grid = grid;
  splat(surfels_,
        blocks_.in_view(map_T_camera, grid, splat_options.farthest, splat_options.active_since),
        splat_options, view);
}

FuseReport SurfelMap::fuse(const Frame& frame, const ModelView& prediction) {
  const PinholeGrid& grid = frame.grid;
  if (!(grid == prediction.grid) || !frame.depth.same_size(grid.width, grid.height) ||
      !frame.albedo.same_size(grid.width, grid.height) ||
      !prediction.surfel.same_size(grid.width, grid.height)) {
    throw std::invalid_argument(
        "surfel map: the frame, its planes and the prediction must have one grid; predict with "
        "the frame's");
  }
  FuseReport report;
  estimate_normals(frame.depth, grid, depth_gate(frame), normals_);
  pixels_.assign(frame.depth.size(), Pixel{});
  parallel_for_chunks(static_cast<std::size_t>(grid.height), kRowsAtATime,
                      [&](std::size_t begin, std::size_t end) {
                        for (std::size_t v = begin; v < end; ++v) {
                          judge_row(frame, prediction, static_cast<int>(v));
                        }
                      });

  // Of several pixels that see one surfel, the nearest to it has it.
  claims_.clear();
  for (std::size_t k = 0; k < pixels_.size(); ++k) {
    if (pixels_[k].verdict != Verdict::kAssociated) continue;
    std::int32_t& claim = claim_of_[static_cast<std::size_t>(pixels_[k].surfel)];
    if (claim < 0) {
      claim = static_cast<std::int32_t>(claims_.size());
      claims_.push_back(static_cast<std::int32_t>(k));
    } else {
      std::int32_t& holder = claims_[static_cast<std::size_t>(claim)];
      if (pixels_[k].distance2 < pixels_[static_cast<std::size_t>(holder)].distance2) {
        holder = static_cast<std::int32_t>(k);
      }
    }
  }
  parallel_for_chunks(claims_.size(), kClaimsAtATime, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      const auto pixel = static_cast<std::size_t>(claims_[c]);
      update(pixels_[pixel].surfel, measure(frame, prediction.map_T_camera, pixel), frame.utime);
    }
  });
  find_crowded(prediction);
  // What one pixel confirms is not in free space, whatever another sees.
  seen_through_.clear();
  for (const Pixel& pixel : pixels_) {
    if (pixel.verdict != Verdict::kSeenThrough) continue;
    std::int32_t& claim = claim_of_[static_cast<std::size_t>(pixel.surfel)];
    if (claim < 0) {
      claim = 0;
      seen_through_.push_back(pixel.surfel);
    }
  }
  for (const std::int32_t pixel : claims_) {
    const std::int32_t id = pixels_[static_cast<std::size_t>(pixel)].surfel;
    const auto index = static_cast<std::size_t>(id);
    claim_of_[index] = -1;
    blocks_.move(id, {surfels_.x[index], surfels_.y[index], surfels_.z[index]},
                 surfels_.radius[index], surfels_.updated[index]);
    mark_changed(id);
  }
  for (const std::int32_t id : seen_through_) {
    claim_of_[static_cast<std::size_t>(id)] = -1;
    report.removed_free_space += see_through(id);
  }
  report.merged = merge_crowded();
  report.associated = static_cast<int>(claims_.size());
  report.seen_through = static_cast<int>(seen_through_.size());
  report.removed_unstable = remove_unseen(frame.utime);
  for (std::size_t k = 0; k < pixels_.size(); ++k) {
    if (pixels_[k].verdict == Verdict::kNew) {
      report.created += create(measure(frame, prediction.map_T_camera, k), frame.utime);
    }
  }
  return report;
}

// Surfels that are seen where another one was measured, and lie on top of that.
void SurfelMap::find_crowded(const ModelView& prediction) {
  const PinholeGrid& grid = prediction.grid;
  const auto blocks =
      blocks_.in_view(prediction.map_T_camera, grid, options_.farthest * options_.working_distance,
                      std::numeric_limits<std::int64_t>::min());
  const Eigen::Matrix3f rotation =
      prediction.map_T_camera.rotation.inverse().toRotationMatrix().cast<float>();
  const Eigen::Vector3f translation = prediction.map_T_camera.inverse().translation.cast<float>();
  const auto fx = static_cast<float>(grid.fx);
  const auto fy = static_cast<float>(grid.fy);
  const auto cx = static_cast<float>(grid.cx);
  const auto cy = static_cast<float>(grid.cy);
  const auto position_of = [this](std::size_t k) {
    return Eigen::Vector3f(surfels_.x[k], surfels_.y[k], surfels_.z[k]);
  };
  const auto normal_of = [this](std::size_t k) {
    return Eigen::Vector3f(surfels_.nx[k], surfels_.ny[k], surfels_.nz[k]);
  };
  const Eigen::Vector3f eye = prediction.map_T_camera.translation.cast<float>();
  // Where the ray to surfel k meets the other's plane: layers err along rays.
  const auto is_on_top = [&](std::size_t k, std::size_t other) {
    const Eigen::Vector3f normal = normal_of(other);
    const Eigen::Vector3f ray = position_of(k) - eye;
    const Eigen::Vector3f offset = position_of(k) - position_of(other);
    const float across = normal.dot(offset);
    const float slope = normal.dot(ray);
    const float thickness = static_cast<float>(options_.merge_thickness) * surfels_.radius[other];
    const float distance = static_cast<float>(options_.merge_distance) * surfels_.radius[other];
    return slope < 0 && std::abs(across) < thickness &&
           (offset - across / slope * ray).norm() < distance &&
           normal.dot(normal_of(k)) > cosine_gate_;
  };
  crowded_.resize(std::max(crowded_.size(), blocks.size()));
  for (auto& found : crowded_) found.clear();
  run_chunks(blocks.size(), [&](std::size_t number) {
    for (const std::int32_t id : blocks[number]) {
      const auto k = static_cast<std::size_t>(id);
      const Eigen::Vector3f centre = rotation * position_of(k) + translation;
      if (!(centre.z() > 0)) continue;
      const float u = std::round(fx * centre.x() / centre.z() + cx);
      const float v = std::round(fy * centre.y() / centre.z() + cy);
      if (!(u >= 0 && u < static_cast<float>(grid.width) && v >= 0 &&
            v < static_cast<float>(grid.height))) {
        continue;
      }
      const std::int32_t into = prediction.surfel.at(static_cast<int>(u), static_cast<int>(v));
      if (into < 0 || into == id || claim_of_[static_cast<std::size_t>(into)] < 0) continue;
      if (is_on_top(k, static_cast<std::size_t>(into))) crowded_[number].push_back({id, into});
    }
  });
}

// One after the other in one order for ever: of two that are on top of each other one stays.
int SurfelMap::merge_crowded() {
  int merged = 0;
  SurfelArrays& s = surfels_;
  for (const auto& found : crowded_) {
    for (const auto& [surfel, into] : found) {
      const auto from = static_cast<std::size_t>(surfel);
      const auto to = static_cast<std::size_t>(into);
      if (!s.holds(from) || !s.holds(to)) continue;
      const std::int64_t updated = std::max(s.updated[from], s.updated[to]);
      const Measurement measured = {{s.x[from], s.y[from], s.z[from]},
                                    {s.nx[from], s.ny[from], s.nz[from]},
                                    s.radius[from],
                                    s.albedo[from],
                                    s.confidence[from]};
      s.initialised[to] = std::min(s.initialised[from], s.initialised[to]);
      update(into, measured, updated);
      remove(surfel);
      blocks_.move(into, {s.x[to], s.y[to], s.z[to]}, s.radius[to], updated);
      mark_changed(into);
      ++merged;
    }
  }
  return merged;
}

float SurfelMap::depth_gate(const Frame& frame) const {
  return static_cast<float>(
      std::max(options_.depth_gate, options_.depth_gate_sigmas * frame.relative_std));
}

void SurfelMap::judge_row(const Frame& frame, const ModelView& prediction, int v) {
  Pixel* row = pixels_.data() + static_cast<std::ptrdiff_t>(v) * frame.grid.width;
  for (int u = 0; u < frame.grid.width; ++u) row[u] = judge(frame, prediction, u, v);
}

SurfelMap::Pixel SurfelMap::judge(const Frame& frame, const ModelView& prediction, int u,
                                  int v) const {
  Pixel pixel;
  const float depth = frame.depth.at(u, v);
  const auto farthest = static_cast<float>(options_.farthest * options_.working_distance);
  if (!(depth > 0 && depth <= farthest)) return pixel;

  const Eigen::Vector3f normal(normals_.x.at(u, v), normals_.y.at(u, v), normals_.z.at(u, v));
  const Eigen::Vector3f point = vertex(frame.grid, u, v, depth);
  const bool usable =
      -normal.dot(point) >= static_cast<float>(options_.minimum_cosine) * point.norm();
  pixel.surfel = prediction.surfel.at(u, v);
  const auto index = static_cast<std::size_t>(pixel.surfel);
  if (pixel.surfel < 0) {
    if (usable) pixel.verdict = Verdict::kNew;
    return pixel;
  }
  if (!surfels_.holds(index)) return pixel;

  const float predicted = prediction.depth.at(u, v);
  const float gate = depth_gate(frame) * depth;
  if (usable && depth < predicted - gate) {
    pixel.verdict = Verdict::kNew;
    return pixel;
  }
  const Eigen::Vector3d centre =
      prediction.map_T_camera.rotation.conjugate() *
      (Eigen::Vector3d(surfels_.x[index], surfels_.y[index], surfels_.z[index]) -
       prediction.map_T_camera.translation);
  if (depth > predicted + gate) {
    // Discs hang over outlines: the surfel's own place must be among the pixels asked.
    const double du = frame.grid.fx * centre.x() / centre.z() + frame.grid.cx - u;
    const double dv = frame.grid.fy * centre.y() / centre.z() + frame.grid.cy - v;
    const bool is_near = std::max(std::abs(du), std::abs(dv)) < 1.5;
    if (is_near && neighbours_see_through(frame, u, v, predicted)) {
      pixel.verdict = Verdict::kSeenThrough;
    }
    return pixel;
  }
  const float cosine = normal.dot(Eigen::Vector3f(
      prediction.normal_x.at(u, v), prediction.normal_y.at(u, v), prediction.normal_z.at(u, v)));
  if (usable && depth >= predicted - gate && cosine >= cosine_gate_) {
    pixel.verdict = Verdict::kAssociated;
    pixel.distance2 = static_cast<float>((centre - point.cast<double>()).squaredNorm());
  }
  return pixel;
}

// Poses err by a fraction of a pixel: at an outline, one pixel that sees past is no proof.
bool SurfelMap::neighbours_see_through(const Frame& frame, int u, int v, float predicted) const {
  const float share = 1 - depth_gate(frame);
  for (int b = std::max(v - 1, 0); b <= std::min(v + 1, frame.grid.height - 1); ++b) {
    for (int a = std::max(u - 1, 0); a <= std::min(u + 1, frame.grid.width - 1); ++a) {
      const float depth = frame.depth.at(a, b);
      if (depth > 0 && depth * share <= predicted) return false;
    }
  }
  return true;
}

SurfelMap::Measurement SurfelMap::measure(const Frame& frame, const SE3& map_T_camera,
                                          std::size_t pixel) const {
  const auto width = static_cast<std::size_t>(frame.grid.width);
  const auto u = static_cast<int>(pixel % width);
  const auto v = static_cast<int>(pixel / width);
  const float depth = frame.depth.values[pixel];
  const Eigen::Vector3d normal(normals_.x.values[pixel], normals_.y.values[pixel],
                               normals_.z.values[pixel]);
  const double excess = std::max(1.0, frame.relative_std / options_.trusted_relative_std);
  const float albedo = frame.albedo.values[pixel];
  Measurement measured;
  measured.position = (map_T_camera * vertex(frame.grid, u, v, depth).cast<double>()).cast<float>();
  measured.normal = (map_T_camera.rotation * normal).cast<float>();
  measured.radius = disc_radius(depth, frame.grid, static_cast<float>(normal.z()));
  measured.albedo = albedo >= 0 ? albedo : -1;
  measured.weight = pixel_weight(frame.grid, u, v) / static_cast<float>(excess * excess);
  return measured;
}

void SurfelMap::update(std::int32_t id, const Measurement& measured, std::int64_t utime) {
  const auto k = static_cast<std::size_t>(id);
  SurfelArrays& s = surfels_;
  if (measured.radius < static_cast<float>(options_.radius_growth) * s.radius[k]) {
    const float share = measured.weight / (s.confidence[k] + measured.weight);
    const auto mix = [share](float& value, float with) { value += share * (with - value); };
    mix(s.x[k], measured.position.x());
    mix(s.y[k], measured.position.y());
    mix(s.z[k], measured.position.z());
    mix(s.radius[k], measured.radius);
    if (s.albedo[k] < 0) {
      s.albedo[k] = measured.albedo;
    } else if (measured.albedo >= 0) {
      mix(s.albedo[k], measured.albedo);
    }
    Eigen::Vector3f normal(s.nx[k], s.ny[k], s.nz[k]);
    normal = (normal + share * (measured.normal - normal)).normalized();
    s.nx[k] = normal.x();
    s.ny[k] = normal.y();
    s.nz[k] = normal.z();
  }
  s.confidence[k] =
      std::min(s.confidence[k] + measured.weight, static_cast<float>(options_.confidence_limit));
  s.updated[k] = std::max(s.updated[k], utime);
}

std::optional<std::size_t> SurfelMap::new_id() {
  std::size_t k = surfels_.size();
  if (free_ids_.empty()) {
    if (k == static_cast<std::size_t>(std::numeric_limits<std::int32_t>::max())) return {};
    surfels_.resize(k + 1);
    is_changed_.resize(k + 1);
    claim_of_.resize(k + 1, -1);
  } else {
    k = static_cast<std::size_t>(free_ids_.back());
    free_ids_.pop_back();
  }
  return k;
}

void SurfelMap::add(const SurfelArrays& others) {
  for (std::size_t from = 0; from < others.size(); ++from) {
    if (!others.holds(from)) continue;
    const Eigen::Vector3f position(others.x[from], others.y[from], others.z[from]);
    const std::optional<std::size_t> to = blocks_.reaches(position) ? new_id() : std::nullopt;
    if (!to) continue;
    SurfelArrays::copy(others, from, surfels_, *to);
    const auto id = static_cast<std::int32_t>(*to);
    blocks_.place(id, position, others.radius[from], others.updated[from]);
    ++size_;
    mark_changed(id);
    if (!is_stable(id)) due_[others.updated[from] + unseen_limit_].push_back(id);
  }
}

bool SurfelMap::create(const Measurement& measured, std::int64_t utime) {
  if (!blocks_.reaches(measured.position)) return false;
  const std::optional<std::size_t> free = new_id();
  if (!free) return false;
  const std::size_t k = *free;
  SurfelArrays& s = surfels_;
  s.x[k] = measured.position.x();
  s.y[k] = measured.position.y();
  s.z[k] = measured.position.z();
  s.nx[k] = measured.normal.x();
  s.ny[k] = measured.normal.y();
  s.nz[k] = measured.normal.z();
  s.albedo[k] = measured.albedo;
  s.confidence[k] = measured.weight;
  s.radius[k] = measured.radius;
  s.initialised[k] = utime;
  s.updated[k] = utime;
  const auto id = static_cast<std::int32_t>(k);
  blocks_.place(id, measured.position, measured.radius, utime);
  ++size_;
  mark_changed(id);
  due_[utime + unseen_limit_].push_back(id);
  return true;
}

// Whether the surfel is gone for it.
bool SurfelMap::see_through(std::int32_t id) {
  const auto k = static_cast<std::size_t>(id);
  const bool was_stable = is_stable(id);
  surfels_.confidence[k] /= 2;
  if (static_cast<double>(surfels_.confidence[k]) < options_.least_confidence) {
    remove(id);
    return true;
  }
  mark_changed(id);
  if (was_stable && !is_stable(id)) due_[surfels_.updated[k] + unseen_limit_].push_back(id);
  return false;
}

int SurfelMap::remove_unseen(std::int64_t now) {
  int removed = 0;
  while (!due_.empty() && due_.begin()->first < now) {
    const auto [due, ids] = std::move(*due_.begin());
    due_.erase(due_.begin());
    for (const std::int32_t id : ids) {
      const auto k = static_cast<std::size_t>(id);
      // The entry may be of an earlier bearer of the id.
      const bool is_own = surfels_.holds(k) && surfels_.initialised[k] <= due - unseen_limit_;
      if (!is_own || is_stable(id)) continue;
      const std::int64_t again = surfels_.updated[k] + unseen_limit_;
      if (again < now) {
        remove(id);
        ++removed;
      } else {
        due_[again].push_back(id);
      }
    }
  }
  return removed;
}

void SurfelMap::remove(std::int32_t id) {
  const auto k = static_cast<std::size_t>(id);
  SurfelArrays::for_each_array(surfels_, [k](auto& array) { array[k] = {}; });
  blocks_.remove(id);
  --size_;
  removed_.push_back(id);
}

void SurfelMap::mark_changed(std::int32_t id) {
  std::uint8_t& is_changed = is_changed_[static_cast<std::size_t>(id)];
  if (is_changed == 0) changed_.push_back(id);
  is_changed = 1;
}

void SurfelMap::transform(const Similarity& similarity) {
  SurfelBlocks blocks(options_.block_size * options_.working_distance);
  SurfelArrays& s = surfels_;
  for (std::size_t k = 0; k < s.size(); ++k) {
    if (!s.holds(k)) continue;
    const auto id = static_cast<std::int32_t>(k);
    const Eigen::Vector3f position =
        (similarity * Eigen::Vector3f(s.x[k], s.y[k], s.z[k]).cast<double>()).cast<float>();
    if (!blocks.reaches(position)) {
      remove(id);
      continue;
    }
    const Eigen::Vector3f normal =
        similarity.rotation.cast<float>() * Eigen::Vector3f(s.nx[k], s.ny[k], s.nz[k]);
    s.x[k] = position.x();
    s.y[k] = position.y();
    s.z[k] = position.z();
    s.nx[k] = normal.x();
    s.ny[k] = normal.y();
    s.nz[k] = normal.z();
    s.radius[k] *= static_cast<float>(similarity.scale);
    blocks.place(id, position, s.radius[k], s.updated[k]);
    mark_changed(id);
  }
  blocks_ = std::move(blocks);
}

void SurfelMap::deform(const DeformationGraph& graph) {
  // A surfel follows the nodes nearest to it, which are at most some spacings off.
  constexpr double kSpacings = 4;
  std::vector<Eigen::Vector3d> moving;
  for (const DeformationNode& node : graph.nodes()) {
    if (!node.affine.isIdentity(0) || !node.translation.isZero(0)) moving.push_back(node.position);
  }
  const double reach = kSpacings * graph.spacing() +
                       std::sqrt(3.0) / 2 * options_.block_size * options_.working_distance;
  std::vector<std::int32_t> ids;
  for (const SurfelBlock& block : blocks_.blocks()) {
    const bool is_near = std::any_of(moving.begin(), moving.end(), [&](const auto& position) {
      return (position - block.centre).squaredNorm() < reach * reach;
    });
    if (is_near) ids.insert(ids.end(), block.ids.begin(), block.ids.end());
  }
  for (const std::int32_t id : graph.apply(surfels_, ids)) {
    const auto k = static_cast<std::size_t>(id);
    const Eigen::Vector3f position(surfels_.x[k], surfels_.y[k], surfels_.z[k]);
    if (!blocks_.reaches(position)) {
      remove(id);
      continue;
    }
    blocks_.move(id, position, surfels_.radius[k], surfels_.updated[k]);
    mark_changed(id);
  }
}

void SurfelMap::give_way(const Frame& frame, const SE3& map_T_camera) {
  constexpr int kLayers = 10;        // one behind the other
  constexpr float kSameWall = 0.3F;  // of depth: as far as a wall may have come nearer
  const auto stable = static_cast<float>(options_.stable_confidence);
  ModelView view;
  bool any = true;
  for (int layer = 0; layer < kLayers && any; ++layer) {
    any = false;
    predict(map_T_camera, frame.grid, frame.utime, MapPart::kAll, view);
    for (std::size_t pixel = 0; pixel < frame.depth.size(); ++pixel) {
      const float depth = frame.depth.values[pixel];
      const std::int32_t id = view.surfel.values[pixel];
      if (!(depth > 0) || id < 0 || !surfels_.holds(static_cast<std::size_t>(id))) continue;
      const float behind = view.depth.values[pixel] / depth - 1;
      if (behind < -depth_gate(frame) || (behind > depth_gate(frame) && behind < kSameWall)) {
        remove(id);
        any = true;
      } else if (float& confidence = surfels_.confidence[static_cast<std::size_t>(id)];
                 confidence > stable) {
        confidence = stable;
        mark_changed(id);
      }
    }
  }
}

MapIncrement SurfelMap::take_increment() {
  MapIncrement increment;
  for (const std::int32_t id : changed_) {
    is_changed_[static_cast<std::size_t>(id)] = 0;
    if (surfels_.holds(static_cast<std::size_t>(id))) increment.changed.push_back(id);
  }
  increment.removed = std::move(removed_);
  std::sort(increment.changed.begin(), increment.changed.end());
  std::sort(increment.removed.begin(), increment.removed.end());
  free_ids_.insert(free_ids_.end(), increment.removed.rbegin(), increment.removed.rend());
  changed_.clear();
  removed_.clear();
  return increment;
}

}  // namespace gastronaut::slam

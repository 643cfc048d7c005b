#include "visual_slam/loop_search.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace gastronaut::slam {
namespace {

constexpr double kMicroseconds = 1e6;  // a second
constexpr int kLeastRows = 80;         // for the levels of a tracker

// Means over blocks of pixels that all have depth, respectively albedo, of one surface.
Frame coarser(const Frame& frame, int factor) {
  constexpr float kOneSurface = 0.05F;  // of depth, from the nearest to the farthest
  Frame coarse;
  coarse.utime = frame.utime;
  coarse.relative_std = frame.relative_std;
  coarse.grid = frame.grid.coarser(factor);
  coarse.depth = Plane<float>(coarse.grid.width, coarse.grid.height);
  coarse.albedo = Plane<float>(coarse.grid.width, coarse.grid.height);
  const auto pixels = static_cast<float>(factor * factor);
  for (int v = 0; v < coarse.grid.height; ++v) {
    for (int u = 0; u < coarse.grid.width; ++u) {
      float nearest = std::numeric_limits<float>::infinity();
      float farthest = 0;
      float darkest = std::numeric_limits<float>::infinity();
      float depth = 0;
      float albedo = 0;
      for (int b = factor * v; b < factor * (v + 1); ++b) {
        for (int a = factor * u; a < factor * (u + 1); ++a) {
          const float at = frame.depth.at(a, b);
          nearest = std::min(nearest, at);
          farthest = std::max(farthest, at);
          depth += at;
          darkest = std::min(darkest, frame.albedo.at(a, b));
          albedo += frame.albedo.at(a, b);
        }
      }
      const bool is_one = nearest > 0 && farthest <= (1 + kOneSurface) * nearest;
      coarse.depth.at(u, v) = is_one ? depth / pixels : 0;
      coarse.albedo.at(u, v) = darkest >= 0 ? albedo / pixels : -1;
    }
  }
  return coarse;
}

struct Overlap {
  double share = 0;     // of the keyframe's pixels with depth
  double distance = 0;  // metres, mean depth of the common ones
};

Overlap overlap_of(const Frame& keyframe, const ModelView& view) {
  std::size_t known = 0;
  std::size_t common = 0;
  double sum = 0;
  for (std::size_t k = 0; k < keyframe.depth.size(); ++k) {
    if (!(keyframe.depth.values[k] > 0)) continue;
    ++known;
    if (!(view.depth.values[k] > 0)) continue;
    ++common;
    sum += static_cast<double>(view.depth.values[k]);
  }
  if (common == 0) return {};
  return {static_cast<double>(common) / static_cast<double>(known),
          sum / static_cast<double>(common)};
}

std::string why_not_there(const TrackingResult& result, const std::optional<PlaceGate>& gate) {
  if (result.status != TrackingStatus::kOk) return result.cause;
  if (!gate) return {};
  const double off = (result.map_T_camera.translation - gate->position).norm();
  if (off <= gate->radius) return {};
  return fmt::format("{:.2g} mm from where the magnet has the camera, which is {:.2g} mm too far",
                     1e3 * off, 1e3 * (off - gate->radius));
}

}  // namespace

LoopSearch::LoopSearch(const PinholeGrid& grid, const TrackerOptions& tracker,
                       const LoopSearchOptions& options)
    : options_(options),
      factor_(
          std::clamp(grid.width / options.most_columns, 1, std::max(1, grid.height / kLeastRows))),
      tracker_(grid.coarser(factor_), tracker) {}

LoopMatch LoopSearch::look(const Frame& keyframe, const SE3& map_T_camera, const SurfelMap& map,
                           const Relocaliser& places, const std::optional<PlaceGate>& gate) {
  const Frame coarse = coarser(keyframe, factor_);
  LoopMatch match = look_from(coarse, map_T_camera, map, gate);
  if (!match.is_placed && options_.candidates > 0 && keyframe.utime >= global_due_) {
    global_due_ = keyframe.utime + std::llround(options_.global_interval * kMicroseconds);
    for (const SE3& place :
         places.candidates(keyframe, options_.candidates, map.old_before(keyframe.utime))) {
      LoopMatch far = look_from(coarse, place, map, gate);
      far.is_global = true;
      if (far.is_accepted() || !match.is_old) match = std::move(far);
      if (match.is_accepted()) break;
    }
  }
  match.keyframe = coarse;
  return match;
}

LoopMatch LoopSearch::look_from(const Frame& keyframe, const SE3& map_T_camera,
                                const SurfelMap& map, const std::optional<PlaceGate>& gate) {
  LoopMatch match;
  ModelView& view = match.old;
  map.predict(map_T_camera, keyframe.grid, keyframe.utime, MapPart::kOld, view);
  const Overlap overlap = overlap_of(keyframe, view);
  match.overlap = overlap.share;
  match.is_old = overlap.share >= options_.least_overlap;
  if (!match.is_old) return match;

  const TrackingResult result = tracker_.track(keyframe, view, map_T_camera);
  match.map_T_camera = result.map_T_camera;
  match.covariance = result.covariance;
  match.inlier_fraction = result.inlier_fraction;
  match.icp_rms = result.icp_rms;
  match.refusal = why_not_there(result, gate);
  if (!match.refusal.empty()) return match;

  map.predict(result.map_T_camera, keyframe.grid, keyframe.utime, MapPart::kOld, view);
  const TrackingResult again = tracker_.track(keyframe, view, result.map_T_camera);
  const SE3 between = result.map_T_camera.inverse() * again.map_T_camera;
  const double turn = angle_between(between.rotation, Eigen::Quaterniond::Identity());
  match.is_placed = again.status == TrackingStatus::kOk &&
                    between.translation.norm() <= options_.same_place * overlap.distance &&
                    turn <= options_.same_place;
  if (!match.is_placed) {
    match.refusal = "a second look leads elsewhere";
    return match;
  }
  Frame fitted = keyframe;
  for (float& depth : fitted.depth.values) depth *= static_cast<float>(result.depth_scale);
  match.wall = find_wall_motion(fitted, view, options_.wall);
  if (result.inlier_fraction < options_.least_inliers) {
    match.refusal =
        fmt::format("only {:.0f} % of what both see fits", 100 * result.inlier_fraction);
  } else if (result.icp_rms > options_.largest_residual * overlap.distance) {
    match.refusal = fmt::format("{:.2g} mm between the surfaces", 1e3 * result.icp_rms);
  }
  return match;
}

}  // namespace gastronaut::slam

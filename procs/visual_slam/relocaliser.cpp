#include "visual_slam/relocaliser.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <stdexcept>
#include <utility>

namespace gastronaut::slam {
namespace {

constexpr int kTinyWidth = 20;   // pixels
constexpr int kLocal = 3;        // pixels to each side: the local mean of albedo
constexpr float kClip = 3;       // standard deviations: shine is no more than that
constexpr double kUnit = 2000;   // length of each half of a code
constexpr double kEnough = 0.3;  // of the pixels must have depth, respectively albedo
constexpr double kTurn = std::numbers::pi / 12;  // step of the in-plane rotation
constexpr int kTurns = 2;                        // steps to each side
constexpr int kShift = 2;                        // pixels
constexpr int kShifts = 2;                       // steps to each side
constexpr std::size_t kRefined = 12;             // matches
constexpr int kFineTurns = 2 * kTurns + 1;       // half steps to each side
constexpr int kDepthStep = 2;  // depth is smooth: every second pixel of it is enough
constexpr int kLeastPairs = 20;
constexpr double kSameDepth = 0.2;  // pairs further off their motion, as a fraction, are left out
constexpr int kFits = 3;

// Integers: the same whatever the width of the processor's vectors.
std::int32_t dot(const std::vector<std::int16_t>& a, const std::vector<std::int16_t>& b) {
  std::int32_t sum = 0;
  for (std::size_t k = 0; k < a.size(); ++k) {
    sum += static_cast<std::int32_t>(a[k]) * static_cast<std::int32_t>(b[k]);
  }
  return sum;
}

// To a given length; what there is none of is 0 and stays so.
void append_unit(const std::vector<float>& values, double length, std::vector<std::int16_t>& code) {
  double square = 0;
  for (const float value : values) square += static_cast<double>(value) * value;
  const double factor = square > 0 ? length / std::sqrt(square) : 0;
  for (const float value : values) {
    code.push_back(static_cast<std::int16_t>(std::nearbyint(factor * static_cast<double>(value))));
  }
}

}  // namespace

Relocaliser::Relocaliser(const PinholeGrid& grid, const RelocaliserOptions& options)
    : grid_(grid),
      options_(options),
      factor_(std::max(1, grid.width / kTinyWidth)),
      tiny_(grid.coarser(factor_)),
      margin_(kShift * kShifts + 1) {
  if (grid.width < kTinyWidth || tiny_.height < 2 * kLocal || options.most < 1 ||
      !(options.distance > 0) || !(options.angle > 0) || !(options.depth_weight >= 0)) {
    throw std::invalid_argument(
        "relocaliser: pictures must be 20 pixels wide or more and not flat, distance and angle "
        "positive, most at least 1, depth_weight not negative");
  }
  for (int turn = -kFineTurns; turn <= kFineTurns; ++turn) turned_.push_back(turned_pixels(turn));
}

Relocaliser::Tiny Relocaliser::shrink(const Frame& frame) const {
  if (!(frame.grid == grid_) || !frame.depth.same_size(grid_.width, grid_.height) ||
      !frame.albedo.same_size(grid_.width, grid_.height)) {
    throw std::invalid_argument("relocaliser: the frame has another grid than the first");
  }
  Tiny tiny;
  std::vector<float> depths;
  int seen = 0;
  const int half = factor_ * factor_ / 2;
  for (int v = 0; v < tiny_.height; ++v) {
    for (int u = 0; u < tiny_.width; ++u) {
      float albedo = 0, depth = 0;
      int albedos = 0, measured = 0;
      for (int j = 0; j < factor_; ++j) {
        const float* a = frame.albedo.row(v * factor_ + j) + u * factor_;
        const float* d = frame.depth.row(v * factor_ + j) + u * factor_;
        for (int i = 0; i < factor_; ++i) {
          if (a[i] >= 0 && std::isfinite(a[i])) albedo += a[i], ++albedos;
          if (d[i] > 0 && std::isfinite(d[i])) depth += d[i], ++measured;
        }
      }
      tiny.albedo.push_back(albedos > half ? albedo / static_cast<float>(albedos) : -1);
      tiny.depth.push_back(measured > half ? depth / static_cast<float>(measured) : 0);
      if (tiny.albedo.back() >= 0) ++seen;
      if (tiny.depth.back() > 0) depths.push_back(tiny.depth.back());
    }
  }
  const double pixels = static_cast<double>(tiny.depth.size());
  if (static_cast<double>(depths.size()) < kEnough * pixels || seen < kEnough * pixels) return tiny;
  // Less the local mean, over the deviation of the whole.
  std::vector<float> contrast(tiny.albedo.size());
  double square = 0;
  for (int v = 0; v < tiny_.height; ++v) {
    for (int u = 0; u < tiny_.width; ++u) {
      const auto at = static_cast<std::size_t>(v * tiny_.width + u);
      if (tiny.albedo[at] < 0) continue;
      float sum = 0;
      int count = 0;
      for (int j = std::max(0, v - kLocal); j <= std::min(tiny_.height - 1, v + kLocal); ++j) {
        for (int i = std::max(0, u - kLocal); i <= std::min(tiny_.width - 1, u + kLocal); ++i) {
          const float value = tiny.albedo[static_cast<std::size_t>(j * tiny_.width + i)];
          if (value >= 0) sum += value, ++count;
        }
      }
      contrast[at] = tiny.albedo[at] - sum / static_cast<float>(count);
      square += static_cast<double>(contrast[at]) * contrast[at];
    }
  }
  const auto limit = kClip * static_cast<float>(std::sqrt(square / seen));
  for (float& value : contrast) value = std::clamp(value, -limit, limit);
  tiny.contrast = std::move(contrast);
  for (const float depth : tiny.depth) tiny.log_depth.push_back(depth > 0 ? std::log(depth) : 0);
  const auto middle = depths.begin() + static_cast<std::ptrdiff_t>(depths.size() / 2);
  std::nth_element(depths.begin(), middle, depths.end());
  tiny.distance = static_cast<double>(*middle);
  return tiny;
}

// Where each pixel comes from when the picture is turned about its middle by half steps, without
// bounds: column, then row.
std::vector<std::int16_t> Relocaliser::turned_pixels(int half_turns) const {
  std::vector<std::int16_t> from;
  const double angle = half_turns * kTurn / 2;
  const int margin = margin_;
  for (int v = -margin; v < tiny_.height + margin; ++v) {
    for (int u = -margin; u < tiny_.width + margin; ++u) {
      const double x = u - tiny_.cx;
      const double y = v - tiny_.cy;
      const auto i = std::lround(std::cos(angle) * x + std::sin(angle) * y + tiny_.cx);
      const auto j = std::lround(std::cos(angle) * y - std::sin(angle) * x + tiny_.cy);
      const bool inside = i >= 0 && i < tiny_.width && j >= 0 && j < tiny_.height;
      from.push_back(static_cast<std::int16_t>(inside ? j * tiny_.width + i : -1));
    }
  }
  return from;
}

const std::int16_t* Relocaliser::sources_of_row(int v, const Alignment& a) const {
  const int first = (v - a.dv + margin_) * (tiny_.width + 2 * margin_) + margin_ - a.du;
  return turned_[static_cast<std::size_t>(a.half_turns + kFineTurns)].data() + first;
}

std::vector<std::int16_t> Relocaliser::code(const Tiny& tiny, const Alignment& alignment) const {
  std::vector<float> albedo(tiny.depth.size());
  std::vector<float> depth((albedo.size() + 1) / 2);
  std::size_t depths = 0;
  float sum = 0;
  int count = 0;
  float* contrast = albedo.data();
  for (int v = 0; v < tiny_.height; ++v) {
    const std::int16_t* sources = sources_of_row(v, alignment);
    for (int u = 0; u < tiny_.width; ++u) {
      const int from = sources[u];
      *contrast++ = from >= 0 ? tiny.contrast[static_cast<std::size_t>(from)] : 0;
    }
    if (v % kDepthStep != 0) continue;
    for (int u = 0; u < tiny_.width; u += kDepthStep) {
      const int from = sources[u];
      // Never exactly 0 where there is depth, short of a depth of one metre.
      const float value = from >= 0 ? tiny.log_depth[static_cast<std::size_t>(from)] : 0;
      depth[depths++] = value;
      sum += value;
      count += value != 0 ? 1 : 0;
    }
  }
  depth.resize(depths);
  const float mean = count > 0 ? sum / static_cast<float>(count) : 0;
  for (float& value : depth) value -= value != 0 ? mean : 0;
  std::vector<std::int16_t> result;
  result.reserve(albedo.size() + depth.size());
  append_unit(albedo, kUnit, result);
  append_unit(depth, kUnit * std::sqrt(options_.depth_weight), result);
  return result;
}

bool Relocaliser::add(const Frame& frame, const SE3& map_T_camera) {
  Tiny tiny = shrink(frame);
  if (!(tiny.distance > 0)) return false;
  double nearest = 0;
  std::size_t place = 0;
  for (std::size_t k = 0; k < keyframes_.size(); ++k) {
    const SE3& other = keyframes_[k].map_T_camera;
    const double off =
        std::max((other.translation - map_T_camera.translation).norm() /
                     (options_.distance * std::min(tiny.distance, keyframes_[k].distance)),
                 angle_between(other.rotation, map_T_camera.rotation) / options_.angle);
    if (off < 1) return false;
    if (k == 0 || off < nearest) nearest = off, place = k;
  }
  Keyframe keyframe{frame.utime, map_T_camera, tiny.distance, code(tiny, {}),
                    std::move(tiny.depth)};
  if (size() < options_.most) {
    keyframes_.push_back(std::move(keyframe));
  } else {
    keyframes_[place] = std::move(keyframe);
  }
  return true;
}

std::vector<SE3> Relocaliser::candidates(const Frame& frame, int most,
                                         std::int64_t seen_before) const {
  const Tiny tiny = shrink(frame);
  std::vector<SE3> poses;
  if (!(tiny.distance > 0)) return poses;
  const double whole = kUnit * kUnit * (1 + options_.depth_weight);
  const auto better = [](const Match& a, const Match& b) {
    return a.score != b.score ? a.score > b.score : a.keyframe < b.keyframe;
  };
  std::vector<int> old;
  for (std::size_t k = 0; k < keyframes_.size(); ++k) {
    if (keyframes_[k].utime < seen_before) old.push_back(static_cast<int>(k));
  }
  std::vector<Match> matches(old.size());
  const auto try_at = [&](const Alignment& alignment, const std::vector<std::int16_t>& moved,
                          int keyframe, Match& match) {
    const std::vector<std::int16_t>& other = keyframes_[static_cast<std::size_t>(keyframe)].code;
    const auto score = static_cast<float>(dot(moved, other) / whole);
    if (match.keyframe < 0 || score > match.score) {
      match = {score, keyframe, alignment};
    }
  };
  for (int turn = -kTurns; turn <= kTurns; ++turn) {
    for (int j = -kShifts; j <= kShifts; ++j) {
      for (int i = -kShifts; i <= kShifts; ++i) {
        const Alignment alignment{2 * turn, i * kShift, j * kShift};
        const auto moved = code(tiny, alignment);
        for (std::size_t k = 0; k < old.size(); ++k) try_at(alignment, moved, old[k], matches[k]);
      }
    }
  }
  const std::size_t refined = std::min(kRefined, matches.size());
  std::partial_sort(matches.begin(), matches.begin() + static_cast<std::ptrdiff_t>(refined),
                    matches.end(), better);
  matches.resize(refined);
  for (Match& match : matches) {
    const Alignment start = match.alignment;
    for (int turn = -1; turn <= 1; ++turn) {
      for (int dv = -1; dv <= 1; ++dv) {
        for (int du = -1; du <= 1; ++du) {
          const Alignment alignment{start.half_turns + turn, start.du + du, start.dv + dv};
          try_at(alignment, code(tiny, alignment), match.keyframe, match);
        }
      }
    }
  }
  std::sort(matches.begin(), matches.end(), better);
  for (const Match& match : matches) {
    if (static_cast<int>(poses.size()) >= most ||
        static_cast<double>(match.score) < options_.least_score) {
      break;
    }
    SE3 pose;
    if (correct(tiny, match, pose)) poses.push_back(pose);
  }
  return poses;
}

bool Relocaliser::correct(const Tiny& tiny, const Match& match, SE3& map_T_camera) const {
  const Keyframe& keyframe = keyframes_[static_cast<std::size_t>(match.keyframe)];
  const auto vertex = [&](int pixel, float depth) -> Eigen::Vector3d {
    return static_cast<double>(depth) * Eigen::Vector3d((pixel % tiny_.width - tiny_.cx) / tiny_.fx,
                                                        (pixel / tiny_.width - tiny_.cy) / tiny_.fy,
                                                        1);
  };
  Eigen::Matrix3Xd here(3, tiny.depth.size());
  Eigen::Matrix3Xd there(3, tiny.depth.size());
  Eigen::Index count = 0;
  for (int pixel = 0; pixel < static_cast<int>(tiny.depth.size()); ++pixel) {
    const int from = sources_of_row(pixel / tiny_.width, match.alignment)[pixel % tiny_.width];
    if (from < 0) continue;
    const float depth_here = tiny.depth[static_cast<std::size_t>(from)];
    const float depth_there = keyframe.depth[static_cast<std::size_t>(pixel)];
    if (!(depth_here > 0 && depth_there > 0)) continue;
    here.col(count) = vertex(from, depth_here);
    there.col(count) = vertex(pixel, depth_there);
    ++count;
  }
  SE3 motion;
  for (int fit = 0; fit < kFits; ++fit) {
    if (count < kLeastPairs) return false;
    const Eigen::Matrix4d matrix =
        Eigen::umeyama(here.leftCols(count), there.leftCols(count), false);
    motion.rotation =
        Eigen::Quaterniond(Eigen::Matrix3d(matrix.topLeftCorner<3, 3>())).normalized();
    motion.translation = matrix.topRightCorner<3, 1>();
    Eigen::Index kept = 0;
    for (Eigen::Index k = 0; k < count; ++k) {
      const Eigen::Vector3d off = motion * Eigen::Vector3d(here.col(k)) - there.col(k);
      if (off.norm() > kSameDepth * there(2, k)) continue;
      here.col(kept) = here.col(k);
      there.col(kept) = there.col(k);
      ++kept;
    }
    count = kept;
  }
  map_T_camera = keyframe.map_T_camera * motion;
  return true;
}

void Relocaliser::add(const Relocaliser& other) {
  for (const Keyframe& keyframe : other.keyframes_) {
    if (size() < options_.most) keyframes_.push_back(keyframe);
  }
}

void Relocaliser::transform(const Similarity& similarity) {
  for (Keyframe& keyframe : keyframes_) {
    keyframe.map_T_camera = similarity * keyframe.map_T_camera;
    keyframe.distance *= similarity.scale;
    for (float& depth : keyframe.depth) depth *= static_cast<float>(similarity.scale);
  }
}

void Relocaliser::deform(const DeformationGraph& graph) {
  for (Keyframe& keyframe : keyframes_) {
    keyframe.map_T_camera = graph.moved(keyframe.map_T_camera, TimeSpan::at(keyframe.utime));
  }
}

std::vector<SE3> Relocaliser::viewpoints() const {
  std::vector<SE3> poses;
  for (const Keyframe& keyframe : keyframes_) poses.push_back(keyframe.map_T_camera);
  return poses;
}

}  // namespace gastronaut::slam

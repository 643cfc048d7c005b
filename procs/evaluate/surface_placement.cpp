#include "evaluate/surface_placement.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <numbers>
#include <stdexcept>

#include "evaluate/trajectory_errors.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut::evaluation {
namespace {

// Second singular value of centred points, relative to the first, below which they count as lying
// on a line: nobody picks points to better than a thousandth of the distance between them.
constexpr double kCollinear = 1e-3;

Points thinned(const Points& points, std::size_t most) {
  Points result;
  const std::size_t step = (points.size() + most - 1) / most;
  for (std::size_t i = 0; i < points.size(); i += step) result.push_back(points[i]);
  return result;
}

Eigen::Map<const Eigen::Matrix3Xd> columns(const Points& points) {
  return {points.front().data(), 3, static_cast<Eigen::Index>(points.size())};
}

// Middle, principal axes (largest first, right-handed) and distance from the middle (RMS).
struct Extent {
  Eigen::Vector3d middle;
  Eigen::Matrix3d axes;
  double radius = 0;
};

Extent extent_of(const Points& points) {
  Extent extent;
  const Eigen::Map<const Eigen::Matrix3Xd> matrix = columns(points);
  extent.middle = matrix.rowwise().mean();
  const Eigen::Matrix3Xd centred = matrix.colwise() - extent.middle;
  const Eigen::Matrix3d covariance =
      centred * centred.transpose() / static_cast<double>(points.size());
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance);
  extent.axes = solver.eigenvectors().rowwise().reverse();
  if (extent.axes.determinant() < 0) extent.axes.col(2) *= -1;
  extent.radius = std::sqrt(covariance.trace());
  return extent;
}

// Spread evenly over all rotations: super-Fibonacci spirals (Alexa, CVPR 2022).
std::vector<Eigen::Quaterniond> even_rotations(int count) {
  constexpr double kPhi = std::numbers::sqrt2;
  constexpr double kPsi = 1.533751168755204288118041;  // psi^4 = psi + 4
  std::vector<Eigen::Quaterniond> rotations;
  for (int i = 0; i < count; ++i) {
    const double s = i + 0.5;
    const double inner = std::sqrt(s / count);
    const double outer = std::sqrt(1 - s / count);
    const double alpha = 2 * std::numbers::pi * s / kPhi;
    const double beta = 2 * std::numbers::pi * s / kPsi;
    rotations.emplace_back(inner * std::sin(alpha), inner * std::cos(alpha), outer * std::sin(beta),
                           outer * std::cos(beta));
  }
  return rotations;
}

// Spread over the points: each is the furthest from those before, the first from `start`.
Points spread_over(const Points& points, const Eigen::Vector3d& start, int count) {
  Points chosen;
  std::vector<double> distances(points.size(), std::numeric_limits<double>::infinity());
  Eigen::Vector3d last = start;
  for (int i = 0; i < count; ++i) {
    for (std::size_t k = 0; k < points.size(); ++k) {
      distances[k] = std::min(distances[k], (points[k] - last).squaredNorm());
    }
    const auto furthest = std::max_element(distances.begin(), distances.end());
    last = points[static_cast<std::size_t>(furthest - distances.begin())];
    chosen.push_back(last);
  }
  return chosen;
}

// Where the map's middle may lie: in the middle of the surface, and in that of each of some parts
// of it that extend as far from their middle as the map does.
Points possible_middles(const Points& samples, const Extent& surface, const Extent& map) {
  constexpr int kParts = 8;
  constexpr double kWhole = 0.9;  // a map of that share of the surface's radius is all of it
  Points middles = {surface.middle};
  if (map.radius > kWhole * surface.radius) return middles;
  for (const Eigen::Vector3d& place : spread_over(samples, surface.middle, kParts)) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    double count = 0;
    for (const Eigen::Vector3d& sample : samples) {
      if ((sample - place).norm() > std::numbers::sqrt2 * map.radius) continue;
      sum += sample;
      ++count;
    }
    middles.push_back(sum / count);
  }
  return middles;
}

struct Candidate {
  SE3 rig_T_map;
  double rmse = 0;
};

// Closest points from each of the candidates, which come back ordered by what they reach.
void refine(const TrueSurface& surface, const Points& points, const IcpOptions& options,
            std::vector<Candidate>& candidates) {
  parallel_for_chunks(candidates.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Candidate& candidate = candidates[i];
      candidate.rig_T_map =
          align_to_surface(surface, points, candidate.rig_T_map, options).rig_T_map;
      candidate.rmse = statistics(surface_distances(surface, points, candidate.rig_T_map)).rmse;
    }
  });
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.rmse < b.rmse; });
}

// The best ones that are not the same place: that leave the map's points elsewhere.
void keep_best(std::vector<Candidate>& candidates, std::size_t count, const Extent& map) {
  constexpr double kSame = 0.1;  // of the map's radius
  const auto same = [&](const SE3& a, const SE3& b) {
    const SE3 difference = a.inverse() * b;
    return (difference * map.middle - map.middle).norm() +
               map.radius * so3_log(difference.rotation).norm() <
           kSame * map.radius;
  };
  std::vector<Candidate> kept;
  for (const Candidate& candidate : candidates) {
    if (kept.size() == count) break;
    if (std::none_of(kept.begin(), kept.end(), [&](const Candidate& other) {
          return same(other.rig_T_map, candidate.rig_T_map);
        })) {
      kept.push_back(candidate);
    }
  }
  candidates = std::move(kept);
}

}  // namespace

std::vector<PointPair> read_pairs(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot read " + path);
  std::vector<PointPair> pairs;
  std::string line;
  bool first_row = true;
  for (int number = 1; std::getline(file, line); ++number) {
    if (line.ends_with('\r')) line.pop_back();
    if (line.empty() || line.front() == '#') continue;
    std::array<double, 6> values{};
    const char* at = line.data();
    const char* const end = line.data() + line.size();
    std::size_t count = 0;
    for (; count < values.size(); ++count) {
      while (at != end && *at == ' ') ++at;
      const auto [after, error] = std::from_chars(at, end, values[count]);
      if (error != std::errc{} || !std::isfinite(values[count])) break;
      at = after;
      while (at != end && *at == ' ') ++at;
      if (count + 1 < values.size()) {
        if (at == end || *at != ',') break;
        ++at;
      }
    }
    const bool names = first_row && count == 0;
    first_row = false;
    if (names) continue;
    if (count != values.size() || at != end) {
      throw std::runtime_error(path + ":" + std::to_string(number) + ": \"" + line +
                               "\" is no pair; write six numbers separated by commas: map x, y, z, "
                               "surface x, y, z in metres");
    }
    pairs.push_back({{values[0], values[1], values[2]}, {values[3], values[4], values[5]}});
  }
  return pairs;
}

SE3 place_by_pairs(std::span<const PointPair> pairs) {
  constexpr std::size_t kLeast = 3;
  if (pairs.size() < kLeast) {
    throw std::invalid_argument("there are " + std::to_string(pairs.size()) +
                                " pairs of points; a rigid alignment needs three or more (the "
                                "paper picks six)");
  }
  Points from;
  Points to;
  for (const PointPair& pair : pairs) {
    from.push_back(pair.map);
    to.push_back(pair.surface);
  }
  for (const auto& [points, where] : {std::pair{&from, "map"}, std::pair{&to, "surface"}}) {
    const Eigen::Matrix3Xd centred =
        columns(*points).colwise() - Eigen::Vector3d(columns(*points).rowwise().mean());
    const Eigen::Vector3d spread = Eigen::JacobiSVD<Eigen::Matrix3Xd>(centred).singularValues();
    if (!(spread[1] > kCollinear * spread[0])) {
      throw std::invalid_argument(std::string("the points picked on the ") + where +
                                  " lie on a line, about which the map could be turned at will; "
                                  "pick another one beside it");
    }
  }
  const Eigen::Matrix4d transform = Eigen::umeyama(columns(from), columns(to), false);
  return {Eigen::Quaterniond(transform.topLeftCorner<3, 3>()).normalized(),
          transform.topRightCorner<3, 1>()};
}

ShapePlacement place_by_shape(const TrueSurface& surface, const Points& map_points) {
  constexpr std::size_t kSamples = 4000;  // of the surface
  constexpr int kRotations = 192;         // none is further than 30 degrees from one of them
  const Points samples = sample_surface(surface.mesh(), kSamples);
  const Extent surface_extent = extent_of(samples);
  const Extent map_extent = extent_of(map_points);

  std::vector<Eigen::Quaterniond> rotations = even_rotations(kRotations);
  for (const Eigen::Vector3d& signs :
       {Eigen::Vector3d(1, 1, 1), {1, -1, -1}, {-1, 1, -1}, {-1, -1, 1}}) {
    rotations.emplace_back(surface_extent.axes * signs.asDiagonal() * map_extent.axes.transpose());
  }
  std::vector<Candidate> candidates;
  for (const Eigen::Vector3d& middle : possible_middles(samples, surface_extent, map_extent)) {
    for (const Eigen::Quaterniond& rotation : rotations) {
      candidates.push_back(
          {{rotation.normalized(), middle - rotation.normalized() * map_extent.middle}});
    }
  }
  struct Stage {
    std::size_t points;
    int iterations;
    std::size_t kept;  // candidates
  };
  for (const auto& [points, iterations, kept] :
       {Stage{100, 12, 40}, Stage{500, 30, 8}, Stage{4000, 200, 2}}) {
    refine(surface, thinned(map_points, points),
           {.iterations = iterations, .tolerance = 1e-7, .most_points = points}, candidates);
    keep_best(candidates, kept, map_extent);
  }
  return {candidates[0].rig_T_map, candidates[0].rmse,
          candidates.size() > 1 ? candidates[1].rmse : std::numeric_limits<double>::quiet_NaN()};
}

}  // namespace gastronaut::evaluation

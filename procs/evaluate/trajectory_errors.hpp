// Errors of a trajectory: absolute (after alignment) and relative, as evo and the TUM RGB-D
// benchmark define them.
#pragma once

#include <span>
#include <string>
#include <utility>
#include <vector>

#include "evaluate/trajectory.hpp"

namespace gastronaut::evaluation {

struct Statistics {
  std::size_t count = 0;
  double rmse = 0;
  double mean = 0;
  double median = 0;
  double std = 0;  // of the population
  double min = 0;
  double max = 0;
  double sum_of_squares = 0;
};
// All not-a-number for no values.
Statistics statistics(std::span<const double> values);
// Value below which the fraction (0..1) of the values lies, interpolated; NaN for no values.
double quantile(std::vector<double> values, double fraction);

enum class AlignmentKind { kNone, kSe3, kSim3 };

struct Alignment {
  double scale = 1;
  Pose truth_T_estimate;  // applied after the scale
  // False where the points lie on a line or in a point: the errors are still the smallest
  // possible, but a rotation (and for a point the scale) is arbitrary.
  bool rotation_determined = true;

  Eigen::Vector3d operator*(const Eigen::Vector3d& point) const {
    return truth_T_estimate.rotation * (scale * point) + truth_T_estimate.translation;
  }
};

// The rotation (never a reflection), translation and, for Sim(3), scale that bring the estimated
// positions closest to the true ones. Umeyama, PAMI 13(4), 1991. Poses without truth do not count.
Alignment align(const MatchedTrajectory& matched, AlignmentKind kind);

// Distance in metres of each aligned position from the true one; poses without truth left out.
std::vector<double> absolute_errors(const MatchedTrajectory& matched, const Alignment& alignment);

enum class DeltaUnit { kFrames, kMetres, kSeconds, kDegrees };

struct Delta {
  double value = 1;
  DeltaUnit unit = DeltaUnit::kFrames;
};
// "10m", "5mm", "1s", "5frames", "5deg". Throws std::invalid_argument that says what is possible.
Delta parse_delta(const std::string& text);

struct PairSelection {
  Delta delta;
  // Every pose starts a pair, or the next pair starts where the last one ended. Pairs by seconds
  // always start at every pose.
  bool all_pairs = false;
  // Lengths and angles are those of the true path, which noise does not lengthen; else, as evo has
  // it, of the estimated one. The true path needs the truth of every pose.
  bool along_truth = false;
  // With all pairs: how far the pair's delta may be off, as a fraction of it.
  double tolerance = 0.1;
};

// Pairs (from, to) of indices. Lengths and angles are accumulated along the path. By seconds, the
// pair goes from the later pose to the earlier one, as in the TUM benchmark.
std::vector<std::pair<std::size_t, std::size_t>> select_pairs(const MatchedTrajectory& matched,
                                                              const PairSelection& selection);

struct RelativeErrors {
  std::vector<double> translation;  // metres
  std::vector<double> rotation;     // radians
};
// Of (truth_i^-1 truth_j)^-1 (estimate_i^-1 estimate_j); pairs without truth at an end drop out.
RelativeErrors relative_errors(const MatchedTrajectory& matched,
                               std::span<const std::pair<std::size_t, std::size_t>> pairs);

}  // namespace gastronaut::evaluation

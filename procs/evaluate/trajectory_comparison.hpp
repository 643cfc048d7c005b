// One trajectory file against another, as evo prints it.
#pragma once

#include <string>

#include "evaluate/metrics.hpp"
#include "trajectory/trajectory_file.hpp"

namespace gastronaut::evaluation {

struct TrajectoryComparison {
  std::string estimate;  // files
  std::string truth;
  TrajectoryFormat format = TrajectoryFormat::kTum;
  double max_difference = 0.01;  // seconds between poses that belong together; TUM only
  std::string delta = "1frames";
  bool all_pairs = false;
  bool pairs_along_truth = false;
};

struct ComparedTrajectories {
  MatchedTrajectory matched;  // every pose of the estimate
  Metrics metrics;            // ESTIMATE.ate.*, ESTIMATE.rpe.*
};

// Throws std::runtime_error for files that cannot be read or do not belong together, and
// std::invalid_argument for an impossible delta.
ComparedTrajectories compare_trajectories(const TrajectoryComparison& comparison);

// The statistics as a table for people.
std::string describe(const TrajectoryComparison& comparison, const ComparedTrajectories& compared);

// Writes all of a report but the plots into the existing folder.
void write_comparison(const TrajectoryComparison& comparison, const ComparedTrajectories& compared,
                      const std::string& folder);

}  // namespace gastronaut::evaluation

// Trials as tables for people, and as one row a frame for plots.
#pragma once

#include <fstream>
#include <span>
#include <string>
#include <vector>

#include "bench/visual_slam/trial_scores.hpp"

namespace gastronaut::slam {

struct ScoredTrial {
  Trial trial;
  TrialScores scores;
};

// All print to standard output; "-" where nothing can be said.
void print_header(const std::string& method, const std::string& rpe_path,
                  const std::string& rpe_angle);
void print_row(const ScoredTrial& scored);
// Least, median, 90 % and largest of each figure over the runs of a method.
void print_distribution(std::span<const ScoredTrial> trials);
// One row a method: its first run, medians and worst over all runs, sums of failures.
void print_comparison(std::span<const std::vector<ScoredTrial>> methods);

// Comma-separated values. SI units; angles as quaternions, sigma_rotation in radians.
class FrameTable {
 public:
  // Throws std::runtime_error when the file cannot be written; an empty path writes nothing.
  explicit FrameTable(const std::string& path);

  void add(const ScoredTrial& scored);

 private:
  std::ofstream file_;
};

}  // namespace gastronaut::slam

// What depth_estimator made of the pictures: depth against the truth, whether surface points keep
// their albedo, and chosen frames for the eye.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "camera/pinhole_grid.hpp"
#include "evaluate/evaluate_process.hpp"
#include "evaluate/metrics.hpp"

namespace gastronaut::evaluation {

// DEPTH.*: over all pixels with truth, by true distance (DEPTH.15_to_30mm.* and so on), and the
// scale of the frames. Nothing when no DEPTH has truth.
void set_depth_metrics(Metrics& metrics, const DepthSeries& depth);

struct ShownFrame {
  std::size_t number = 0;
  std::int64_t utime = 0;
  std::optional<PinholeGrid> grid;  // of its undistorted picture, where that can be told
};

// Reads the pictures of `log`, which `run` was read from, frame by frame. Writes those to be shown
// (`frames`: their numbers; none: a few) into FOLDER/frames and sets albedo.*, luminance.*, clahe.*
// and constancy.*; returns the frames shown. What could not be used is added to the run's notes.
// Throws std::runtime_error.
std::vector<ShownFrame> evaluate_pictures(Metrics& metrics, const std::string& log,
                                          const std::string& folder,
                                          const std::vector<std::size_t>& frames, RecordedRun& run);

}  // namespace gastronaut::evaluation

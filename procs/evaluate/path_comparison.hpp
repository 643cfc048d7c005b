// The paper's comparison of localisation by magnet, by vision and by both: trajectory error against
// the length of the trajectory.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "evaluate/metrics.hpp"
#include "evaluate/trajectory.hpp"

namespace gastronaut::evaluation {

// A stretch of the true path, by its times (microseconds).
struct PathPiece {
  std::int64_t begin = 0;
  std::int64_t end = 0;
};
// Pieces of `length` that begin every `spacing` along the path (both metres), the first of them at
// its start, as far as the path reaches.
std::vector<PathPiece> path_pieces(const TruthTrack& truth, double length, double spacing);

// What is compared: the name its figures get, and its usable poses.
struct ComparedChannel {
  std::string name;
  const MatchedTrajectory& usable;
  bool in_rig_frame;  // else only aligned errors say something
};
// For lengths of 50, 100, 150 and 200 mm comparison.LENGTHmm.NAME.followed, the number of pieces of
// the camera's true path through which the channel has usable poses nearly all of the time; .count,
// the number of those that every channel followed (but one that followed none), so that all are
// compared on the same pieces; and the mean over these of the RMS position error: .se3 with each
// piece aligned, and with `in_rig_frame` .none, not aligned. Never with scale. No errors for a
// length of which there is no such piece, and nothing for one that the channel never followed.
void set_comparison_metrics(Metrics& metrics, const TruthTrack& truth,
                            std::span<const ComparedChannel> channels);

}  // namespace gastronaut::evaluation

#include "evaluate/path_comparison.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "evaluate/pose_channel.hpp"
#include "evaluate/trajectory_errors.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr int kLengths[] = {50, 100, 150, 200};  // millimetres
constexpr double kSpacing = 0.02;                // metres
// A channel that was silent for more of a piece did not follow it.
constexpr double kLeastAvailability = 0.9;

// The part of a trajectory within the piece, where its truth is known.
MatchedTrajectory part_of(const MatchedTrajectory& matched, const PathPiece& piece) {
  MatchedTrajectory part;
  const std::vector<std::int64_t>& utimes = matched.estimate.utimes;
  const auto first = std::lower_bound(utimes.begin(), utimes.end(), piece.begin);
  for (auto i = static_cast<std::size_t>(first - utimes.begin());
       i < utimes.size() && utimes[i] <= piece.end; ++i) {
    if (!matched.truth[i]) continue;
    part.estimate.utimes.push_back(utimes[i]);
    part.estimate.poses.push_back(matched.estimate.poses[i]);
    part.truth.push_back(matched.truth[i]);
  }
  return part;
}

// Whether the channel has usable poses nearly all through each piece.
std::vector<char> pieces_followed(const MatchedTrajectory& usable,
                                  const std::vector<PathPiece>& pieces) {
  const std::int64_t interval = median_interval(usable.estimate.utimes);
  std::vector<char> followed;
  for (const PathPiece& piece : pieces) {
    const Trajectory part = part_of(usable, piece).estimate;
    followed.push_back(availability(part.utimes, interval, piece.begin, piece.end) >=
                       kLeastAvailability);
  }
  return followed;
}

}  // namespace

std::vector<PathPiece> path_pieces(const TruthTrack& truth, double length, double spacing) {
  std::vector<double> travelled(truth.size(), 0);
  for (std::size_t i = 1; i < travelled.size(); ++i) {
    travelled[i] =
        travelled[i - 1] + (truth.poses()[i].translation - truth.poses()[i - 1].translation).norm();
  }
  const auto time_at = [&](double place) -> std::int64_t {
    const auto after = std::lower_bound(travelled.begin(), travelled.end(), place);
    const auto i = static_cast<std::size_t>(after - travelled.begin());
    if (i == 0) return truth.utimes()[0];
    const double fraction = (place - travelled[i - 1]) / (travelled[i] - travelled[i - 1]);
    return truth.utimes()[i - 1] +
           std::llround(fraction * static_cast<double>(truth.utimes()[i] - truth.utimes()[i - 1]));
  };
  std::vector<PathPiece> pieces;
  for (int n = 0; !travelled.empty() && n * spacing + length <= travelled.back(); ++n) {
    pieces.push_back({time_at(n * spacing), time_at(n * spacing + length)});
  }
  return pieces;
}

void set_comparison_metrics(Metrics& metrics, const TruthTrack& truth,
                            std::span<const ComparedChannel> channels) {
  for (const int length : kLengths) {
    const std::vector<PathPiece> pieces = path_pieces(truth, 1e-3 * length, kSpacing);
    std::vector<char> common(pieces.size(), 1);
    std::vector<std::size_t> followed;
    for (const ComparedChannel& channel : channels) {
      const std::vector<char> own = pieces_followed(channel.usable, pieces);
      followed.push_back(static_cast<std::size_t>(std::count(own.begin(), own.end(), 1)));
      if (followed.back() == 0) continue;
      for (std::size_t i = 0; i < pieces.size(); ++i) common[i] &= own[i];
    }
    for (std::size_t k = 0; k < channels.size(); ++k) {
      if (followed[k] == 0) continue;
      std::vector<double> unaligned;
      std::vector<double> aligned;
      for (std::size_t i = 0; i < pieces.size(); ++i) {
        if (common[i] == 0) continue;
        const MatchedTrajectory part = part_of(channels[k].usable, pieces[i]);
        unaligned.push_back(statistics(absolute_errors(part, Alignment{})).rmse);
        aligned.push_back(statistics(absolute_errors(part, align(part, AlignmentKind::kSe3))).rmse);
      }
      const std::string key = "comparison." + std::to_string(length) + "mm." + channels[k].name;
      metrics.set_count(key + ".followed", followed[k]);
      metrics.set_count(key + ".count", aligned.size());
      if (aligned.empty()) continue;
      if (channels[k].in_rig_frame) metrics.set(key + ".none", statistics(unaligned).mean);
      metrics.set(key + ".se3", statistics(aligned).mean);
    }
  }
}

}  // namespace gastronaut::evaluation

#include "magnetics/coil_field.hpp"

#include <algorithm>

namespace gastronaut {
namespace {
// Readings wait for at most a few samples of current; this many bridge any configured lag.
constexpr std::size_t kMostSamples = 4096;
}  // namespace

void CurrentHistory::add(std::int64_t utime, Eigen::VectorXd currents) {
  if (!samples_.empty() && utime <= samples_.back().utime) return;
  samples_.push_back({utime, std::move(currents)});
  if (samples_.size() > kMostSamples) samples_.pop_front();
}

std::optional<std::int64_t> CurrentHistory::newest() const {
  if (samples_.empty()) return std::nullopt;
  return samples_.back().utime;
}

std::optional<Eigen::VectorXd> CurrentHistory::at(std::int64_t utime) const {
  const auto after = std::lower_bound(samples_.begin(), samples_.end(), utime,
                                      [](const Sample& s, std::int64_t t) { return s.utime < t; });
  if (after == samples_.end()) {
    if (samples_.empty() || utime - samples_.back().utime > max_gap_us_) return std::nullopt;
    return samples_.back().currents;
  }
  if (after->utime == utime) return after->currents;
  if (after == samples_.begin()) {
    if (after->utime - utime > max_gap_us_) return std::nullopt;
    return after->currents;
  }
  const auto before = std::prev(after);
  if (after->utime - before->utime > max_gap_us_) return std::nullopt;
  if (after->currents.size() != before->currents.size()) return std::nullopt;
  const double fraction = static_cast<double>(utime - before->utime) /
                          static_cast<double>(after->utime - before->utime);
  return before->currents + fraction * (after->currents - before->currents);
}

}  // namespace gastronaut

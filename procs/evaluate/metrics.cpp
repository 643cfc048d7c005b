#include "evaluate/metrics.hpp"

#include <numbers>

namespace gastronaut::evaluation {

void Metrics::set_statistics(const std::string& key, const std::vector<double>& values,
                             double factor) {
  if (values.empty()) return;
  const Statistics all = statistics(values);
  set(key + ".rmse", factor * all.rmse);
  set(key + ".mean", factor * all.mean);
  set(key + ".median", factor * all.median);
  set(key + ".std", factor * all.std);
  set(key + ".min", factor * all.min);
  set(key + ".max", factor * all.max);
}

void set_absolute_errors(Metrics& metrics, const std::string& key,
                         const MatchedTrajectory& matched) {
  metrics.set_statistics(key + ".none", absolute_errors(matched, Alignment{}));
  metrics.set_statistics(key + ".se3",
                         absolute_errors(matched, align(matched, AlignmentKind::kSe3)));
  const Alignment similarity = align(matched, AlignmentKind::kSim3);
  metrics.set_statistics(key + ".sim3", absolute_errors(matched, similarity));
  if (matched.count_matched() > 0) metrics.set(key + ".sim3.scale", similarity.scale);
}

void set_relative_errors(Metrics& metrics, const std::string& key,
                         std::span<const MatchedTrajectory> parts, const PairSelection& selection) {
  RelativeErrors errors;
  for (const MatchedTrajectory& part : parts) {
    const RelativeErrors within = relative_errors(part, select_pairs(part, selection));
    errors.translation.insert(errors.translation.end(), within.translation.begin(),
                              within.translation.end());
    errors.rotation.insert(errors.rotation.end(), within.rotation.begin(), within.rotation.end());
  }
  metrics.set_count(key + ".count", errors.translation.size());
  metrics.set_statistics(key + ".trans", errors.translation);
  metrics.set_statistics(key + ".rot_deg", errors.rotation, 180 / std::numbers::pi);
}

}  // namespace gastronaut::evaluation

#include "surfels/surfel_store.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace gastronaut {
namespace {

constexpr float kFarthest = 1e4F;  // metres: no map of ours reaches there

bool is_sound(const Surfel& surfel) {
  return surfel.position.allFinite() && surfel.position.cwiseAbs().maxCoeff() < kFarthest &&
         surfel.radius > 0 && surfel.radius < kFarthest && std::isfinite(surfel.confidence);
}

void keep_measured_utime(Surfel& surfel, const Surfel& before) {
  if (surfel.confidence <= before.confidence && surfel.colour == before.colour &&
      surfel.radius == before.radius) {
    surfel.measured_utime = before.measured_utime;
  }
}

}  // namespace

bool SurfelStore::set(std::int32_t id, Surfel surfel) {
  const float norm = surfel.normal.norm();
  if (id < 0 || !is_sound(surfel) || !(norm > 0) || !std::isfinite(norm)) return false;
  surfel.normal /= norm;
  const auto known = surfels_.find(id);
  const auto forgotten = before_reset_.find(id);
  if (known != surfels_.end()) {
    keep_measured_utime(surfel, known->second);
  } else if (forgotten != before_reset_.end()) {
    keep_measured_utime(surfel, forgotten->second);
  }
  surfels_.insert_or_assign(id, surfel);
  return true;
}

void SurfelStore::remove(std::int32_t id) {
  surfels_.erase(id);
  before_reset_.erase(id);
}

void SurfelStore::reset() {
  before_reset_ = std::move(surfels_);
  surfels_.clear();
}

std::size_t SurfelStore::stable(double least_confidence) const {
  return static_cast<std::size_t>(
      std::count_if(surfels_.begin(), surfels_.end(),
                    [&](const auto& entry) { return is_stable(entry.second, least_confidence); }));
}

std::vector<Surfel> SurfelStore::list() const {
  std::vector<std::pair<std::int32_t, const Surfel*>> by_id;
  by_id.reserve(surfels_.size());
  for (const auto& [id, surfel] : surfels_) by_id.emplace_back(id, &surfel);
  std::sort(by_id.begin(), by_id.end());
  std::vector<Surfel> list;
  list.reserve(by_id.size());
  for (const auto& [id, surfel] : by_id) list.push_back(*surfel);
  return list;
}

}  // namespace gastronaut

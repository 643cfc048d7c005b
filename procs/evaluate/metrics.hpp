// The figures of a report by name: one flat list, in the order in which they are set, that
// metrics.json holds line by line.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "evaluate/trajectory_errors.hpp"

namespace gastronaut::evaluation {

class Metrics {
 public:
  using Value = std::variant<double, std::int64_t, std::string>;

  void set(std::string key, double value) { list_.emplace_back(std::move(key), value); }
  void set(std::string key, std::string value) {
    list_.emplace_back(std::move(key), std::move(value));
  }
  void set_count(std::string key, std::size_t value) {
    list_.emplace_back(std::move(key), static_cast<std::int64_t>(value));
  }
  // KEY.rmse, .mean, .median, .std, .min, .max of the values times `factor`; nothing for no values.
  void set_statistics(const std::string& key, const std::vector<double>& values, double factor = 1);

  const std::vector<std::pair<std::string, Value>>& list() const { return list_; }

 private:
  std::vector<std::pair<std::string, Value>> list_;
};

// KEY.none, KEY.se3 and KEY.sim3, each with statistics in metres, and KEY.sim3.scale.
void set_absolute_errors(Metrics& metrics, const std::string& key,
                         const MatchedTrajectory& matched);
// KEY.count, KEY.trans (metres) and KEY.rot_deg, of the pairs within each of the parts.
void set_relative_errors(Metrics& metrics, const std::string& key,
                         std::span<const MatchedTrajectory> parts, const PairSelection& selection);

}  // namespace gastronaut::evaluation

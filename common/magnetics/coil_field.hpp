// Field of the actuation coils at the sensors: linear in the currents.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <deque>
#include <optional>

namespace gastronaut {

// Readings (tesla, channel by channel: sensor by sensor, its axes in order) that the coils alone
// cause: field = matrix * currents, matrix in tesla per ampere, one row a channel.
class CoilField {
 public:
  CoilField() = default;
  explicit CoilField(Eigen::MatrixXd tesla_per_ampere) : matrix_(std::move(tesla_per_ampere)) {}

  Eigen::Index num_channels() const { return matrix_.rows(); }
  Eigen::Index num_coils() const { return matrix_.cols(); }
  const Eigen::MatrixXd& matrix() const { return matrix_; }
  Eigen::VectorXd field(const Eigen::VectorXd& currents) const { return matrix_ * currents; }

 private:
  Eigen::MatrixXd matrix_;
};

// Currents at any time between samples, by linear interpolation. Samples are added in order of
// utime; what is older than one sample before `keep` seconds is forgotten.
class CurrentHistory {
 public:
  // Gaps between samples longer than max_gap (seconds) are not bridged.
  explicit CurrentHistory(double max_gap) : max_gap_us_(static_cast<std::int64_t>(max_gap * 1e6)) {}

  void add(std::int64_t utime, Eigen::VectorXd currents);
  // Newest sample's time, nothing before the first.
  std::optional<std::int64_t> newest() const;
  // Nothing where the two samples around utime are further apart than max_gap, or where utime
  // lies more than max_gap beyond the newest or before the oldest; within it the nearest counts.
  std::optional<Eigen::VectorXd> at(std::int64_t utime) const;

 private:
  struct Sample {
    std::int64_t utime;
    Eigen::VectorXd currents;
  };
  std::int64_t max_gap_us_;
  std::deque<Sample> samples_;
};

}  // namespace gastronaut

#include "evaluate/trajectory_errors.hpp"

#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>
#include <stdexcept>

namespace gastronaut::evaluation {
namespace {

// Second singular value of the cross-covariance, relative to the first, below which the points
// count as collinear: what rounding leaves of an exact line.
constexpr double kCollinear = 1e-12;

// Distance along the path at each pose, in the delta's unit.
std::vector<double> path_lengths(const MatchedTrajectory& matched, DeltaUnit unit,
                                 bool along_truth) {
  const auto pose = [&](std::size_t i) -> const Pose& {
    return along_truth ? matched.truth[i].value() : matched.estimate.poses[i];
  };
  std::vector<double> lengths(matched.estimate.size(), 0);
  for (std::size_t i = 1; i < lengths.size(); ++i) {
    double step = 1;
    switch (unit) {
      case DeltaUnit::kFrames:
        break;
      case DeltaUnit::kMetres:
        step = (pose(i).translation - pose(i - 1).translation).norm();
        break;
      case DeltaUnit::kDegrees:
        step = rotation_angle(pose(i - 1).rotation.transpose() * pose(i).rotation) * 180 /
               std::numbers::pi;
        break;
      case DeltaUnit::kSeconds:
        step =
            static_cast<double>(matched.estimate.utimes[i] - matched.estimate.utimes[i - 1]) * 1e-6;
        break;
    }
    lengths[i] = lengths[i - 1] + step;
  }
  return lengths;
}

// Index whose length is nearest to that of `from` plus delta.
std::size_t nearest_ahead(const std::vector<double>& lengths, std::size_t from, double delta) {
  const double wanted = lengths[from] + delta;
  const auto after =
      std::lower_bound(lengths.begin() + static_cast<std::ptrdiff_t>(from), lengths.end(), wanted);
  auto index = static_cast<std::size_t>(after - lengths.begin());
  if (index == lengths.size()) return index - 1;
  if (index > from && wanted - lengths[index - 1] <= lengths[index] - wanted) --index;
  return index;
}

}  // namespace

Statistics statistics(std::span<const double> values) {
  Statistics result;
  result.count = values.size();
  if (values.empty()) {
    result.rmse = result.mean = result.median = result.std = result.min = result.max =
        result.sum_of_squares = std::numeric_limits<double>::quiet_NaN();
    return result;
  }
  const auto count = static_cast<double>(values.size());
  result.mean = std::accumulate(values.begin(), values.end(), 0.0) / count;
  double squared_deviations = 0;
  for (const double value : values) {
    result.sum_of_squares += value * value;
    squared_deviations += (value - result.mean) * (value - result.mean);
  }
  result.rmse = std::sqrt(result.sum_of_squares / count);
  result.std = std::sqrt(squared_deviations / count);
  result.median = quantile({values.begin(), values.end()}, 0.5);
  result.min = *std::min_element(values.begin(), values.end());
  result.max = *std::max_element(values.begin(), values.end());
  return result;
}

double quantile(std::vector<double> values, double fraction) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::sort(values.begin(), values.end());
  const double place = fraction * static_cast<double>(values.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const std::size_t above = std::min(below + 1, values.size() - 1);
  return values[below] + (place - static_cast<double>(below)) * (values[above] - values[below]);
}

Alignment align(const MatchedTrajectory& matched, AlignmentKind kind) {
  Alignment alignment;
  const auto count = static_cast<Eigen::Index>(matched.count_matched());
  if (kind == AlignmentKind::kNone || count == 0) return alignment;
  Eigen::Matrix3Xd estimate(3, count);
  Eigen::Matrix3Xd truth(3, count);
  Eigen::Index column = 0;
  for (std::size_t i = 0; i < matched.truth.size(); ++i) {
    if (!matched.truth[i]) continue;
    estimate.col(column) = matched.estimate.poses[i].translation;
    truth.col(column++) = matched.truth[i]->translation;
  }
  const Eigen::Vector3d estimate_mean = estimate.rowwise().mean();
  const Eigen::Vector3d truth_mean = truth.rowwise().mean();
  estimate.colwise() -= estimate_mean;
  truth.colwise() -= truth_mean;
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(truth * estimate.transpose(),
                                              Eigen::ComputeFullU | Eigen::ComputeFullV);
  const Eigen::Vector3d& singular = svd.singularValues();
  alignment.rotation_determined = singular[1] > kCollinear * singular[0];
  const bool reflected = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0;
  const Eigen::Vector3d signs(1, 1, reflected ? -1 : 1);
  alignment.truth_T_estimate.rotation =
      svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  const double spread = estimate.squaredNorm();
  if (kind == AlignmentKind::kSim3 && spread > 0) alignment.scale = singular.dot(signs) / spread;
  alignment.truth_T_estimate.translation =
      truth_mean - alignment.scale * (alignment.truth_T_estimate.rotation * estimate_mean);
  return alignment;
}

std::vector<double> absolute_errors(const MatchedTrajectory& matched, const Alignment& alignment) {
  std::vector<double> errors;
  for (std::size_t i = 0; i < matched.truth.size(); ++i) {
    if (!matched.truth[i]) continue;
    errors.push_back(
        (alignment * matched.estimate.poses[i].translation - matched.truth[i]->translation).norm());
  }
  return errors;
}

Delta parse_delta(const std::string& text) {
  struct Unit {
    const char* name;
    DeltaUnit unit;
    double factor;
  };
  constexpr std::array<Unit, 5> kUnits{{{"frames", DeltaUnit::kFrames, 1},
                                        {"m", DeltaUnit::kMetres, 1},
                                        {"mm", DeltaUnit::kMetres, 1e-3},
                                        {"s", DeltaUnit::kSeconds, 1},
                                        {"deg", DeltaUnit::kDegrees, 1}}};
  std::size_t used = 0;
  double value = 0;
  try {
    value = std::stod(text, &used);
  } catch (const std::exception&) {
    used = 0;
  }
  for (const Unit& unit : kUnits) {
    if (used == 0 || text.substr(used) != unit.name) continue;
    const bool whole = unit.unit != DeltaUnit::kFrames || value == std::floor(value);
    if (value > 0 && std::isfinite(value) && whole) return {value * unit.factor, unit.unit};
  }
  throw std::invalid_argument("\"" + text +
                              "\" is no distance between poses; write for example 5frames, 10m, "
                              "5mm, 1s or 5deg");
}

std::vector<std::pair<std::size_t, std::size_t>> select_pairs(const MatchedTrajectory& matched,
                                                              const PairSelection& selection) {
  const auto& [value, unit] = selection.delta;
  const std::vector<double> lengths = path_lengths(matched, unit, selection.along_truth);
  std::vector<std::pair<std::size_t, std::size_t>> pairs;
  if (lengths.empty()) return pairs;
  if (unit == DeltaUnit::kSeconds || selection.all_pairs) {
    for (std::size_t i = 0; i + 1 < lengths.size(); ++i) {
      const std::size_t j = nearest_ahead(lengths, i, value);
      const bool close = std::abs(lengths[j] - lengths[i] - value) <= selection.tolerance * value;
      if (j == i || !close) continue;
      // The last pose may be nearest only because the trajectory ends there.
      if (unit != DeltaUnit::kSeconds) {
        pairs.emplace_back(i, j);
      } else if (j + 1 != lengths.size()) {
        pairs.emplace_back(j, i);
      }
    }
    return pairs;
  }
  // evo starts its first pair by length only where the path first reaches the delta.
  std::optional<std::size_t> start;
  if (unit != DeltaUnit::kMetres) start = 0;
  double start_length = 0;
  for (std::size_t i = 1; i < lengths.size(); ++i) {
    if (lengths[i] - start_length < value) continue;
    if (start) pairs.emplace_back(*start, i);
    start = i;
    start_length = lengths[i];
  }
  return pairs;
}

RelativeErrors relative_errors(const MatchedTrajectory& matched,
                               std::span<const std::pair<std::size_t, std::size_t>> pairs) {
  RelativeErrors errors;
  for (const auto& [i, j] : pairs) {
    if (!matched.truth[i] || !matched.truth[j]) continue;
    const Pose true_motion = matched.truth[i]->inverse() * *matched.truth[j];
    const Pose motion = matched.estimate.poses[i].inverse() * matched.estimate.poses[j];
    const Pose error = true_motion.inverse() * motion;
    errors.translation.push_back(error.translation.norm());
    errors.rotation.push_back(rotation_angle(error.rotation));
  }
  return errors;
}

}  // namespace gastronaut::evaluation

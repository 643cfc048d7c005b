#include "magnetic_localizer/global_search.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "magnetics/dipole.hpp"

namespace gastronaut::magnetics {
namespace {

// The nearer the magnet, the finer its field's pattern over the array: layers of points grow
// further apart with depth, and so do the points of a layer.
constexpr double kNearestLayer = 0.012;  // metres below the array's lowest sensor
constexpr double kLayerRatio = 1.4;
constexpr double kSpacingPerDepth = 0.6;
constexpr double kFinestSpacing = 0.022;  // metres
// Points that are tried again with wrong sensors' say taken from them, and candidates in the end.
constexpr std::size_t kMostRetried = 80;
constexpr std::size_t kMostCandidates = 24;
// In the second trial nothing is weighed more than a sensor that is off by this many standard
// deviations.
constexpr double kLeastDeviation = 3;

template <class Candidates>
void keep_best(Candidates& candidates, std::size_t count) {
  count = std::min(count, candidates.size());
  const auto end = candidates.begin() + static_cast<std::ptrdiff_t>(count);
  std::partial_sort(candidates.begin(), end, candidates.end(), [](const auto& a, const auto& b) {
    return a.cost != b.cost ? a.cost < b.cost : a.point < b.point;
  });
  candidates.erase(end, candidates.end());
}

}  // namespace

GlobalSearch::GlobalSearch(const SensorArray& array, const RigConfiguration& configuration)
    : moment_(configuration.magnet.moment),
      background_std_(configuration.magnetic_localizer.background_std) {
  const MagneticLocalizerConfiguration& box = configuration.magnetic_localizer;
  const Eigen::Vector3d centre = array.centre();
  const double lowest = array.position[2].minCoeff();
  const Eigen::Index n = array.num_sensors;
  double depth = 0;
  while (depth < box.search_depth) {
    depth = std::min(depth == 0 ? kNearestLayer : depth * kLayerRatio, box.search_depth);
    const double spacing = std::max(kFinestSpacing, kSpacingPerDepth * depth);
    const int steps = static_cast<int>(std::ceil(box.search_half_width / spacing));
    for (int i = -steps; i <= steps; ++i) {
      for (int j = -steps; j <= steps; ++j) {
        Point point;
        point.position = {centre.x() + box.search_half_width * i / steps,
                          centre.y() + box.search_half_width * j / steps, lowest - depth};
        point.by_moment.resize(3 * n, 3);
        for (Eigen::Index s = 0; s < n; ++s) {
          const Eigen::Vector3d sensor(array.position[0][s], array.position[1][s],
                                       array.position[2][s]);
          const Eigen::Matrix3d by_moment = dipole_field_by_moment(sensor - point.position);
          for (Eigen::Index k = 0; k < 3; ++k) point.by_moment.row(k * n + s) = by_moment.row(k);
        }
        points_.push_back(std::move(point));
      }
    }
  }
}

std::vector<MagnetState> GlobalSearch::candidates(const FieldInformation& information) const {
  const Eigen::Index n = information.scalar.size();
  Eigen::VectorXd field(3 * n);
  Eigen::VectorXd misfits(n);
  std::vector<Candidate> candidates;
  candidates.reserve(points_.size());
  const auto try_point = [&](std::size_t point, const FieldInformation& weighed) {
    const MagnetState state = solve(points_[point], weighed, field);
    sensor_misfits(information, field, misfits);
    const double cost = misfits.cwiseSqrt().sum();
    if (std::isfinite(cost)) candidates.push_back({state, point, cost});
  };
  for (std::size_t point = 0; point < points_.size(); ++point) try_point(point, information);
  keep_best(candidates, kMostRetried);

  const std::vector<Candidate> first = std::move(candidates);
  candidates.clear();
  FieldInformation weighed(n);
  for (const Candidate& candidate : first) {
    solve(points_[candidate.point], information, field);
    sensor_misfits(information, field, misfits);
    const Eigen::VectorXd weight = misfits.cwiseSqrt().cwiseMax(kLeastDeviation).cwiseInverse();
    for (std::size_t entry = 0; entry < weighed.matrix.size(); ++entry) {
      weighed.matrix[entry] = weight.cwiseProduct(information.matrix[entry]);
    }
    for (Eigen::Index k = 0; k < 3; ++k) {
      weighed.vector.segment(k * n, n) = weight.cwiseProduct(information.vector.segment(k * n, n));
    }
    try_point(candidate.point, weighed);
  }
  keep_best(candidates, kMostCandidates);
  std::vector<MagnetState> states;
  for (const Candidate& candidate : candidates) states.push_back(candidate.state);
  return states;
}

MagnetState GlobalSearch::solve(const Point& point, const FieldInformation& information,
                                Eigen::VectorXd& field) const {
  const Eigen::Index n = information.scalar.size();
  // Unknowns: moment, background.
  Eigen::Matrix<double, 6, 6> matrix;
  Eigen::Matrix<double, 6, 1> vector;
  for (int j = 0; j < 3; ++j) {
    apply_information(information.matrix, point.by_moment.col(j).data(), field.data());
    for (int i = 0; i <= j; ++i) {
      matrix(i, j) = point.by_moment.col(i).dot(field);
      matrix(j, i) = matrix(i, j);
    }
    for (int k = 0; k < 3; ++k) {
      matrix(3 + k, j) = field.segment(k * n, n).sum();
      matrix(j, 3 + k) = matrix(3 + k, j);
    }
    vector[j] = point.by_moment.col(j).dot(information.vector);
    vector[3 + j] = information.vector.segment(j * n, n).sum();
  }
  const SensorMatrices& g = information.matrix;
  Eigen::Matrix3d uniform;
  uniform << g[0].sum(), g[1].sum(), g[2].sum(),  //
      g[1].sum(), g[3].sum(), g[4].sum(),         //
      g[2].sum(), g[4].sum(), g[5].sum();
  uniform.diagonal().array() += 1 / (background_std_ * background_std_);
  matrix.bottomRightCorner<3, 3>() = uniform;
  const Eigen::Matrix<double, 6, 1> solution = matrix.llt().solve(vector);

  // The moment's magnitude is known; only its direction and the background are free.
  MagnetState state;
  state.position = point.position;
  state.moment = moment_;
  state.axis = solution.head<3>().normalized();
  const Eigen::Vector3d moment = moment_ * state.axis;
  state.background =
      uniform.llt().solve(vector.tail<3>() - matrix.bottomLeftCorner<3, 3>() * moment);
  field.noalias() = point.by_moment * moment;
  for (Eigen::Index k = 0; k < 3; ++k) field.segment(k * n, n).array() += state.background[k];
  return state;
}

}  // namespace gastronaut::magnetics

#include "calibrate/hand_eye_start.hpp"

#include <Eigen/Cholesky>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

namespace gastronaut {
namespace {

constexpr int kDirections = 40;
constexpr int kIterations = 15;
// Residuals much beyond these pull less: poses that are off, and all of them far from the answer.
constexpr double kAxisKnee = 0.1;        // radians
constexpr double kPositionKnee = 0.003;  // metres
// What keeps the linear step regular when the camera only turned, or only moved.
constexpr double kScaleStd = 0.3;
constexpr double kCentreStd = 0.1;  // metres

struct Sighting {
  SE3 map_T_camera;
  Eigen::Vector3d position;
  Eigen::Vector3d axis;
};

double cauchy_weight(double residual, double knee) {
  return 1 / (1 + (residual / knee) * (residual / knee));
}

// The rotation that takes the second vectors of sum(weight first second^T) nearest to the first
// ones (Wahba's problem).
Eigen::Quaterniond nearest_rotation(const Eigen::Matrix3d& sum) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d signs = Eigen::Vector3d::Ones();
  signs.z() = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1;
  return Eigen::Quaterniond(
      Eigen::Matrix3d(svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose()));
}

// Axis and map rotation in turns, each in closed form given the other.
void fit_axes(const std::vector<Sighting>& sightings, HandEye& hand_eye) {
  std::vector<double> weights(sightings.size(), 1);
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    Eigen::Matrix3d sum = Eigen::Matrix3d::Zero();
    for (std::size_t i = 0; i < sightings.size(); ++i) {
      sum += weights[i] * sightings[i].axis *
             (sightings[i].map_T_camera.rotation * hand_eye.axis).transpose();
    }
    hand_eye.rig_T_map.rotation = nearest_rotation(sum);
    Eigen::Vector3d axis = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < sightings.size(); ++i) {
      const Eigen::Quaterniond rig_R_camera =
          hand_eye.rig_T_map.rotation * sightings[i].map_T_camera.rotation;
      weights[i] =
          cauchy_weight((sightings[i].axis - rig_R_camera * hand_eye.axis).norm(), kAxisKnee);
      axis += weights[i] * (rig_R_camera.conjugate() * sightings[i].axis);
    }
    if (axis.norm() > 0) hand_eye.axis = axis.normalized();
  }
}

// Centre, map translation and scale about those given; returns the robust cost of positions.
double fit_positions(const std::vector<Sighting>& sightings, HandEye& hand_eye) {
  using Vector7 = Eigen::Matrix<double, 7, 1>;
  using Matrix7 = Eigen::Matrix<double, 7, 7>;
  const Eigen::Vector3d expected_centre = hand_eye.centre;
  std::vector<double> weights(sightings.size(), 1);
  double cost = 0;
  for (int iteration = 0; iteration < kIterations; ++iteration) {
    Matrix7 normal = Matrix7::Zero();
    Vector7 right = Vector7::Zero();
    normal.diagonal().head<3>().setConstant(std::pow(kPositionKnee / kCentreStd, 2));
    right.head<3>() = normal(0, 0) * expected_centre;
    normal(6, 6) = std::pow(kPositionKnee / kScaleStd, 2);
    right(6) = normal(6, 6);
    Eigen::Matrix<double, 3, 7> row;
    row.middleCols<3>(3).setIdentity();
    const auto fill = [&](const Sighting& sighting) {
      row.leftCols<3>() =
          (hand_eye.rig_T_map.rotation * sighting.map_T_camera.rotation).toRotationMatrix();
      row.col(6) = hand_eye.rig_T_map.rotation * sighting.map_T_camera.translation;
    };
    for (std::size_t i = 0; i < sightings.size(); ++i) {
      fill(sightings[i]);
      normal += weights[i] * row.transpose() * row;
      right += weights[i] * row.transpose() * sightings[i].position;
    }
    const Vector7 solution = normal.ldlt().solve(right);
    hand_eye.centre = solution.head<3>();
    hand_eye.rig_T_map.translation = solution.segment<3>(3);
    constexpr double kLeastScale = 1e-3;  // vision does not see mirrored
    hand_eye.scale = std::max(kLeastScale, solution(6));
    cost = 0;
    for (std::size_t i = 0; i < sightings.size(); ++i) {
      fill(sightings[i]);
      const double residual = (sightings[i].position - row * solution).norm();
      weights[i] = cauchy_weight(residual, kPositionKnee);
      cost += std::log1p(std::pow(residual / kPositionKnee, 2));
    }
  }
  return cost;
}

double axes_cost(const std::vector<Sighting>& sightings, const HandEye& hand_eye) {
  double cost = 0;
  for (const Sighting& sighting : sightings) {
    const Eigen::Vector3d expected =
        hand_eye.rig_T_map.rotation * (sighting.map_T_camera.rotation * hand_eye.axis);
    cost += std::log1p(std::pow((sighting.axis - expected).norm() / kAxisKnee, 2));
  }
  return cost;
}

}  // namespace

std::vector<HandEye> find_starts(const VisualTrack& track, const std::vector<HandEyePose>& poses,
                                 const HandEye& configured) {
  std::vector<Sighting> sightings;
  for (const HandEyePose& pose : poses) {
    const MagneticFix& fix = pose.fixes[pose.fixes.size() / 2];
    sightings.push_back(
        {track.at(fix.time + configured.time_offset).map_T_camera, fix.position, fix.axis});
  }
  std::vector<Eigen::Vector3d> axes = {configured.axis};
  for (int i = 0; i < kDirections; ++i) {
    // A Fibonacci lattice: equal areas.
    const double z = 1 - (2 * i + 1.0) / kDirections;
    const double turn = i * std::numbers::pi * (3 - std::sqrt(5.0));
    const double across = std::sqrt(1 - z * z);
    axes.emplace_back(across * std::cos(turn), across * std::sin(turn), z);
  }
  std::vector<HandEye> starts;
  std::vector<double> costs;
  for (const Eigen::Vector3d& axis : axes) {
    HandEye start = configured;
    start.axis = axis;
    fit_axes(sightings, start);
    costs.push_back(fit_positions(sightings, start) + axes_cost(sightings, start));
    starts.push_back(start);
  }
  std::vector<std::size_t> order(starts.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return costs[a] < costs[b]; });
  std::vector<HandEye> sorted;
  for (const std::size_t i : order) sorted.push_back(starts[i]);
  return sorted;
}

}  // namespace gastronaut

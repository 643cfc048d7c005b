#include "calibrate/hand_eye_motion.hpp"

#include <spdlog/fmt/fmt.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <cmath>
#include <limits>
#include <numbers>
#include <numeric>

namespace gastronaut {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kTurn = 30 * kDegree;  // what a capsule can be turned by with texture in view
constexpr int kMostPoses = 100;
constexpr double kNearAxis = 25 * kDegree;
constexpr std::array<const char*, 3> kNames = {"x", "y", "z"};

HandEyeMatrix inverse(const HandEyeMatrix& matrix) {
  const HandEyeVector unit = matrix.diagonal().cwiseSqrt().cwiseInverse();
  const HandEyeMatrix scaled = unit.asDiagonal() * matrix * unit.asDiagonal();
  return unit.asDiagonal() * scaled.ldlt().solve(HandEyeMatrix::Identity()) *
         HandEyeMatrix(unit.asDiagonal());
}

// Of centre and axis, in units of the targets.
Matrix5d in_targets(const HandEyeMatrix& covariance) {
  Vector5d unit;
  unit << Eigen::Vector3d::Constant(1 / kCentreTarget), Eigen::Vector2d::Constant(1 / kAxisTarget);
  return unit.asDiagonal() * covariance.topLeftCorner<5, 5>() * unit.asDiagonal();
}

double largest_sigma(const Matrix5d& covariance) {
  return std::sqrt(
      Eigen::SelfAdjointEigenSolver<Matrix5d>(covariance, Eigen::EigenvaluesOnly).eigenvalues()(4));
}

std::string name_direction(const Eigen::Vector3d& direction) {
  Eigen::Index nearest = 0;
  const double along = direction.cwiseAbs().maxCoeff(&nearest);
  if (along > std::cos(kNearAxis)) {
    return fmt::format("{} axis", kNames[static_cast<std::size_t>(nearest)]);
  }
  const Eigen::Vector3d shown = direction(nearest) < 0 ? Eigen::Vector3d(-direction) : direction;
  return fmt::format("direction ({:.1f}, {:.1f}, {:.1f})", shown.x(), shown.y(), shown.z());
}

std::string name_weakest(const HandEye& hand_eye, const Vector5d& direction, double sigma) {
  const Eigen::Vector3d centre = direction.head<3>();
  if (centre.norm() >= direction.tail<2>().norm()) {
    return fmt::format("the magnet's centre along the camera's {}, +-{:.2g} mm",
                       name_direction(centre.normalized()),
                       sigma * centre.norm() * kCentreTarget * 1e3);
  }
  const Eigen::Vector3d turn = perpendicular_basis(hand_eye.axis) * direction.tail<2>();
  return fmt::format("the magnet's axis, by a turn about the camera's {}, +-{:.2g} degrees",
                     name_direction(turn.normalized()),
                     sigma * turn.norm() * kAxisTarget / kDegree);
}

std::string name_motion(const HandEyeAdvice& advice) {
  std::string text;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const int count = advice.more_poses[axis];
    if (count == 0) continue;
    text += fmt::format("{} the camera's {} axis, {}{} more pose{}",
                        text.empty() ? "rotate about" : "; about", kNames[axis],
                        advice.enough ? "" : "over ", count, count == 1 ? "" : "s");
  }
  return text;
}

}  // namespace

HandEyeAdvice advise(const HandEye& hand_eye, const HandEyeMatrix& covariance, const SE3& pose,
                     const Matrix5d& pose_covariance) {
  HandEyeAdvice advice;
  const Eigen::SelfAdjointEigenSolver<Matrix5d> spread(in_targets(covariance));
  advice.sigma = std::sqrt(spread.eigenvalues()(4));
  advice.weakest = name_weakest(hand_eye, spread.eigenvectors().col(4), advice.sigma);

  const Eigen::LLT<Matrix5d> whitening(pose_covariance);
  HandEyeMatrix information = inverse(covariance);
  double sigma = advice.sigma;
  while (sigma > 1) {
    if (std::accumulate(advice.more_poses.begin(), advice.more_poses.end(), 0) == kMostPoses) {
      advice.enough = false;
      break;
    }
    double least = std::numeric_limits<double>::infinity();
    std::size_t best_axis = 0;
    HandEyeMatrix best_information;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      for (const double side : {kTurn, -kTurn}) {
        const Eigen::Vector3d turn = side * Eigen::Vector3d::Unit(static_cast<Eigen::Index>(axis));
        VisualTrack::Sample camera;
        camera.map_T_camera = pose * SE3{so3_exp(turn), Eigen::Vector3d::Zero()};
        MagneticFix fix;
        fix.axis = hand_eye.rig_T_map.rotation * (camera.map_T_camera.rotation * hand_eye.axis);
        HandEyeJacobian row = make_row(hand_eye, camera, fix).jacobian;
        whitening.matrixL().solveInPlace(row);
        const HandEyeMatrix with = information + row.transpose() * row;
        const double trace = in_targets(inverse(with)).trace();
        if (trace < least) {
          least = trace;
          best_axis = axis;
          best_information = with;
        }
      }
    }
    ++advice.more_poses[best_axis];
    information = best_information;
    sigma = largest_sigma(in_targets(inverse(information)));
  }
  advice.motion = name_motion(advice);
  return advice;
}

}  // namespace gastronaut

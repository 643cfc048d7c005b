#include "calibrate/hand_eye_calibration.hpp"

#include <spdlog/fmt/fmt.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "calibrate/calibration_readings.hpp"
#include "calibrate/hand_eye_start.hpp"
#include "calibrate/robust_weight.hpp"

namespace gastronaut {
namespace {

constexpr std::size_t kMostPoses = 100;
constexpr std::size_t kFewestPoses = 6;  // two turns about each of three axes
constexpr std::size_t kStarts = 8;       // refined; the rest are worse by far
constexpr int kMostIterations = 40;
constexpr double kConverged = 1e-9;  // relative decrease of the cost
constexpr double kLeastDamping = 1e-6;
constexpr double kHopelessDamping = 1e9;
constexpr int kRounds = 2;                // of measuring the noise and refining under it
constexpr double kMisfit = 0.5;           // weight below which a pose does not fit
constexpr double kMostMisfits = 0.4;      // of the poses
constexpr double kContradiction = 0.005;  // metres, rms: not noise, but a failure
constexpr double kDegree = std::numbers::pi / 180;
constexpr double kAxisContradiction = 7 * kDegree;
constexpr double kUnknown = 5;          // times the target: a drawing of the capsule says as much
constexpr std::size_t kParts = 20;      // left out one by one when there are many poses
constexpr double kTimeOffsetStd = 0.1;  // seconds, about the configured one

// What is known before: nothing that matters, but never an infinite covariance.
HandEyeMatrix vague_information() {
  HandEyeVector sigmas;
  sigmas << Eigen::Vector3d::Constant(0.1), Eigen::Vector2d::Constant(1),
      Eigen::Vector3d::Constant(3), Eigen::Vector3d::Constant(1), 1, kTimeOffsetStd;
  return sigmas.cwiseAbs2().cwiseInverse().asDiagonal();
}

// How far a step from a start may go where the poses do not say.
HandEyeMatrix trust_information() {
  HandEyeVector sigmas;
  sigmas << Eigen::Vector3d::Constant(0.01), Eigen::Vector2d::Constant(0.2),
      Eigen::Vector3d::Constant(0.2), Eigen::Vector3d::Constant(0.02), 0.1, 0.05;
  return sigmas.cwiseAbs2().cwiseInverse().asDiagonal();
}

class Problem {
 public:
  Problem(const VisualTrack& track, const std::vector<HandEyePose>& poses, double time_offset)
      : track_(track), poses_(poses), time_offset_(time_offset) {}

  std::vector<HandEyeRow> rows(const HandEye& at) const {
    std::vector<HandEyeRow> rows;
    for (const HandEyePose& pose : poses_) rows.push_back(make_row(at, track_, pose));
    return rows;
  }
  HandEyePrior prior(const HandEye& at) const {
    HandEyePrior prior;
    prior.information = vague_information();
    prior.gradient(kTimeOffsetAt) =
        prior.information(kTimeOffsetAt, kTimeOffsetAt) * (time_offset_ - at.time_offset);
    return prior;
  }
  // Levenberg and Marquardt, from where it stands. Returns the cost that is left.
  double refine(HandEye& at, const HandEyeNoise& noise) const {
    std::vector<HandEyeRow> rows = this->rows(at);
    double current = cost(at, rows, noise);
    double damping = 1;
    for (int iteration = 0; iteration < kMostIterations; ++iteration) {
      weigh(rows, noise);
      const double before = current;
      while (damping < kHopelessDamping) {
        HandEyePrior damped = prior(at);
        damped.information += damping * trust_information();
        const HandEye next = stepped(at, solve(rows, noise, damped));
        std::vector<HandEyeRow> next_rows = this->rows(next);
        const double value = cost(next, next_rows, noise);
        if (value < current) {
          at = next;
          rows = std::move(next_rows);
          current = value;
          damping = std::max(kLeastDamping, damping / 10);
          break;
        }
        damping *= 10;
      }
      if (before - current <= kConverged * before) break;
    }
    return current;
  }

 private:
  double cost(const HandEye& at, const std::vector<HandEyeRow>& rows,
              const HandEyeNoise& noise) const {
    return robust_cost(rows, noise) + std::pow((at.time_offset - time_offset_) / kTimeOffsetStd, 2);
  }

  const VisualTrack& track_;
  const std::vector<HandEyePose>& poses_;
  double time_offset_;
};

void leave_out(const std::vector<HandEyeRow>& rows, const HandEyePrior& prior,
               HandEyeCalibration& calibration) {
  calibration.parts = std::min(kParts, rows.size());
  std::vector<Vector5d> shifts;
  Vector5d mean = Vector5d::Zero();
  for (std::size_t part = 0; part < calibration.parts; ++part) {
    std::vector<HandEyeRow> others;
    for (std::size_t i = 0; i < rows.size(); ++i) {
      if (i * calibration.parts / rows.size() != part) others.push_back(rows[i]);
    }
    const Vector5d shift = solve(others, calibration.noise, prior).head<5>();
    shifts.push_back(shift);
    mean += shift / static_cast<double>(calibration.parts);
    calibration.centre_shift = std::max(calibration.centre_shift, shift.head<3>().norm());
    calibration.axis_shift = std::max(calibration.axis_shift, shift.tail<2>().norm());
  }
  const auto parts = static_cast<double>(calibration.parts);
  for (const Vector5d& shift : shifts) {
    calibration.jackknife_std += (parts - 1) / parts * (shift - mean).cwiseAbs2();
  }
  calibration.jackknife_std = calibration.jackknife_std.cwiseSqrt().eval();
}

}  // namespace

HandEyeCalibration calibrate_hand_eye(const VisualTrack& track,
                                      const std::vector<MagneticFix>& fixes,
                                      const HandEye& configured,
                                      const std::function<void(double)>& progress) {
  const std::vector<HandEyePose> poses =
      gather_poses(track, fixes, configured.time_offset, kMostPoses);
  if (poses.size() < kFewestPoses) {
    throw CalibrationRefused(
        fmt::format("only {} poses at least 2 mm or 2 degrees apart have both a magnetic fix and "
                    "vision on either side of it, and {} are the least: move the capsule, and "
                    "rotate it about the camera's x, y and z axes",
                    poses.size(), kFewestPoses));
  }
  const Problem problem(track, poses, configured.time_offset);
  HandEyeCalibration calibration;
  HandEye& estimate = calibration.estimate;
  double least = std::numeric_limits<double>::infinity();
  const std::vector<HandEye> starts = find_starts(track, poses, configured);
  for (std::size_t i = 0; i < std::min(kStarts, starts.size()); ++i) {
    HandEye refined = starts[i];
    const double cost = problem.refine(refined, calibration.noise);
    if (cost < least) {
      least = cost;
      estimate = refined;
    }
    progress(0.5 * static_cast<double>(i + 1) / kStarts);
  }
  for (int round = 0; round < kRounds; ++round) {
    std::vector<HandEyeRow> rows = problem.rows(estimate);
    weigh(rows, calibration.noise, typical_excess(rows, calibration.noise));
    calibration.noise = measure_noise(rows, problem.prior(estimate));
    problem.refine(estimate, calibration.noise);
    progress(0.5 + 0.5 * (round + 1) / (kRounds + 1.0));
  }

  std::vector<HandEyeRow> rows = problem.rows(estimate);
  weigh(rows, calibration.noise);
  const HandEyePrior prior = problem.prior(estimate);
  const auto dof = static_cast<double>(5 * rows.size()) - kHandEyeSize;
  calibration.chi2_per_dof = fitness(rows, calibration.noise, prior).chi2 / dof;
  calibration.covariance = std::max(1.0, calibration.chi2_per_dof) *
                           covariance_of_solution(rows, calibration.noise, prior);
  calibration.poses = poses.size();
  Matrix5d pose_covariance = Matrix5d::Zero();
  double fitting = 0;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    calibration.fixes += poses[i].fixes.size();
    if (rows[i].weight < kMisfit) {
      ++calibration.misfits;
      continue;
    }
    fitting += 1;
    pose_covariance += rows[i].covariance;
    calibration.position_rms += rows[i].residual.head<3>().squaredNorm();
    calibration.axis_rms += rows[i].residual.tail<2>().squaredNorm();
  }
  const auto misfits = static_cast<double>(calibration.misfits);
  calibration.position_rms = std::sqrt(calibration.position_rms / std::max(1.0, fitting));
  calibration.axis_rms = std::sqrt(calibration.axis_rms / std::max(1.0, fitting));
  if (misfits > kMostMisfits * static_cast<double>(rows.size()) ||
      calibration.position_rms > kContradiction || calibration.axis_rms > kAxisContradiction) {
    throw CalibrationRefused(fmt::format(
        "the poses contradict each other: {} of {} do not fit the others, which differ by {:.1f} "
        "mm and {:.1f} degrees. Vision lost its way or a foreign field was near: record again with "
        "the wall in view and other magnets away",
        calibration.misfits, rows.size(), calibration.position_rms * 1e3,
        calibration.axis_rms / kDegree));
  }
  leave_out(rows, prior, calibration);

  pose_covariance /= fitting;
  pose_covariance += hidden_covariance(calibration.noise);
  const HandEyePose& middle = poses[poses.size() / 2];
  calibration.advice = advise(
      estimate, calibration.covariance,
      track.at(middle.fixes.front().time + estimate.time_offset).map_T_camera, pose_covariance);
  if (calibration.advice.sigma > kUnknown) {
    throw CalibrationRefused(fmt::format("the motion leaves {} unknown: {}",
                                         calibration.advice.weakest, calibration.advice.motion));
  }
  return calibration;
}

}  // namespace gastronaut

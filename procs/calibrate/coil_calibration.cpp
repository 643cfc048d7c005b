#include "calibrate/coil_calibration.hpp"

#include <spdlog/fmt/fmt.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "calibrate/magnet_pose_fit.hpp"
#include "calibrate/uniform_field.hpp"

namespace gastronaut {
namespace {

constexpr Eigen::Index kFewestReadings = 50;
constexpr double kLeastDrive = 0.05;        // ampere: below it a coil counts as never driven
constexpr double kLeastIndependent = 0.02;  // ampere rms beside what other coils explain
constexpr double kDriveAboveNoise = 5;      // and this many times the current noise
constexpr double kTakesPart = 0.1;          // share of a coil in a pattern that was never driven
constexpr double kTukey = 4.685;            // sigmas: one normal residual in 350 000 lies beyond
constexpr double kNormalMad = 0.67449;      // median of |standard normal|
constexpr int kRobustIterations = 20;
constexpr double kConverged = 1e-10;
constexpr std::size_t kTimeBlocks = 40;
constexpr double kWanderingChi2 = 3;       // of block means; white residuals have 1
constexpr double kLeastWander = 0.2e-6;    // tesla
constexpr double kUniformShare = 0.8;      // of the wander: a changing background, not a magnet
constexpr double kMagnetShare = 0.8;       // of the offsets' variation that one magnet explains
constexpr double kLeastOffsetPattern = 5;  // times the noise

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::string coil_names(const std::vector<Eigen::Index>& coils) {
  std::string text;
  for (std::size_t i = 0; i < coils.size(); ++i) {
    if (i > 0) text += i + 1 == coils.size() ? " and " : ", ";
    text += std::to_string(coils[i]);
  }
  return text;
}

// Groups of coils of which some combination was never driven.
std::vector<std::vector<Eigen::Index>> undriven_groups(const Eigen::MatrixXd& never_driven,
                                                       const std::vector<Eigen::Index>& coils) {
  const Eigen::MatrixXd shares = never_driven * never_driven.transpose();
  std::vector<bool> seen(coils.size(), false);
  std::vector<std::vector<Eigen::Index>> groups;
  for (std::size_t first = 0; first < coils.size(); ++first) {
    if (seen[first]) continue;
    std::vector<std::size_t> members = {first};
    seen[first] = true;
    for (std::size_t i = 0; i < members.size(); ++i) {
      for (std::size_t other = 0; other < coils.size(); ++other) {
        if (seen[other] || std::abs(shares(static_cast<Eigen::Index>(members[i]),
                                           static_cast<Eigen::Index>(other))) < kTakesPart) {
          continue;
        }
        seen[other] = true;
        members.push_back(other);
      }
    }
    if (members.size() < 2) continue;
    std::sort(members.begin(), members.end());
    std::vector<Eigen::Index> group;
    for (const std::size_t member : members) group.push_back(coils[member]);
    groups.push_back(std::move(group));
  }
  return groups;
}

// Refuses currents that do not tell the coils apart; returns the drive of each coil that no
// combination of the others explains.
Eigen::VectorXd check_drive(const Eigen::MatrixXd& currents, const Eigen::VectorXd& noise) {
  const Eigen::Index num_coils = currents.cols();
  const Eigen::MatrixXd centred = currents.rowwise() - currents.colwise().mean();
  const Eigen::MatrixXd covariance =
      centred.transpose() * centred / static_cast<double>(currents.rows());
  const double least = std::max(kLeastIndependent, kDriveAboveNoise * noise.maxCoeff());
  std::vector<std::string> problems;
  std::vector<Eigen::Index> weak;
  std::vector<Eigen::Index> driven;
  for (Eigen::Index coil = 0; coil < num_coils; ++coil) {
    const double strongest = currents.col(coil).cwiseAbs().maxCoeff();
    if (strongest < kLeastDrive) {
      weak.push_back(coil);
    } else if (std::sqrt(covariance(coil, coil)) < least) {
      problems.push_back(fmt::format("coil {} was held at {:.2f} A: vary its current", coil,
                                     currents.col(coil).mean()));
    } else {
      driven.push_back(coil);
    }
  }
  if (!weak.empty()) {
    problems.push_back(fmt::format("{} {} {} never driven above {} A",
                                   weak.size() == 1 ? "coil" : "coils", coil_names(weak),
                                   weak.size() == 1 ? "was" : "were", kLeastDrive));
  }
  const auto num_driven = static_cast<Eigen::Index>(driven.size());
  Eigen::MatrixXd of_driven(num_driven, num_driven);
  for (Eigen::Index a = 0; a < num_driven; ++a) {
    for (Eigen::Index b = 0; b < num_driven; ++b) {
      of_driven(a, b) =
          covariance(driven[static_cast<std::size_t>(a)], driven[static_cast<std::size_t>(b)]);
    }
  }
  if (num_driven > 0) {
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> modes(of_driven);
    const Eigen::Index undriven = (modes.eigenvalues().array() < least * least).count();
    for (const auto& group : undriven_groups(modes.eigenvectors().leftCols(undriven), driven)) {
      const std::string names = coil_names(group);
      if (group.size() == 2) {
        problems.push_back(fmt::format("coils {} were always driven together", names));
        continue;
      }
      Eigen::MatrixXd part(currents.rows(), static_cast<Eigen::Index>(group.size()));
      for (std::size_t i = 0; i < group.size(); ++i) {
        part.col(static_cast<Eigen::Index>(i)) = centred.col(group[i]);
      }
      const Eigen::VectorXd strengths =
          Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(part.transpose() * part /
                                                         static_cast<double>(part.rows()))
              .eigenvalues();
      problems.push_back(fmt::format("coils {} were driven in only {} independent pattern(s)",
                                     names, (strengths.array() >= least * least).count()));
    }
  }
  if (!problems.empty()) {
    throw CalibrationRefused(
        "the log does not tell the coils apart: " + fmt::format("{}", fmt::join(problems, "; ")) +
        ". Drive each coil by itself, or all with independent currents");
  }
  return covariance.inverse().diagonal().cwiseInverse().cwiseSqrt();
}

struct ChannelFit {
  Eigen::VectorXd solution;  // per coil, then the offset
  Eigen::VectorXd deviation;
  double rms = 0;
  double attenuation = 0;
  Eigen::VectorXd inliers;  // 1 or 0
};

// `design`: currents and a column of ones.
ChannelFit regress(const Eigen::MatrixXd& design, const Eigen::VectorXd& values,
                   const Eigen::VectorXd& usable, const Eigen::VectorXd& current_noise) {
  const Eigen::Index unknowns = design.cols();
  const Eigen::Index num_coils = current_noise.size();
  const auto solve = [&](const Eigen::VectorXd& weights) -> Eigen::VectorXd {
    const Eigen::MatrixXd weighted = weights.asDiagonal() * design;
    return (weighted.transpose() * design).ldlt().solve(weighted.transpose() * values);
  };
  // Tukey's weights find the inliers; least squares on them, unweighted, is what the correction
  // for the currents' noise holds for.
  Eigen::VectorXd robust = solve(usable);
  double sigma = 0;
  for (int iteration = 0; iteration < kRobustIterations; ++iteration) {
    const Eigen::VectorXd residuals = values - design * robust;
    std::vector<double> sizes;
    for (Eigen::Index i = 0; i < residuals.size(); ++i) {
      if (usable(i) > 0) sizes.push_back(std::abs(residuals(i)));
    }
    sigma = median(std::move(sizes)) / kNormalMad;
    if (sigma == 0) break;  // the values are exact
    const Eigen::ArrayXd u = (residuals / (kTukey * sigma)).array();
    const Eigen::VectorXd before = robust;
    robust = solve(usable.array() * (u.abs() < 1).select((1 - u.square()).square(), 0.0));
    if ((robust - before).norm() <= kConverged * before.norm()) break;
  }
  ChannelFit fit;
  fit.inliers =
      usable.array() * ((values - design * robust).array().abs() <= kTukey * sigma).cast<double>();
  const double count = fit.inliers.sum();
  const Eigen::MatrixXd selected = fit.inliers.asDiagonal() * design;
  Eigen::MatrixXd normal = selected.transpose() * design;
  normal.diagonal().head(num_coils) -= count * current_noise.cwiseAbs2();
  const auto factor = normal.ldlt();
  fit.solution = factor.solve(selected.transpose() * values);
  fit.attenuation = (fit.solution - solve(fit.inliers)).head(num_coils).norm() /
                    fit.solution.head(num_coils).norm();
  const double squares = fit.inliers.cwiseProduct(values - design * fit.solution).squaredNorm();
  fit.rms = std::sqrt(squares / count);
  fit.deviation =
      std::sqrt(squares / (count - static_cast<double>(unknowns))) *
      factor.solve(Eigen::MatrixXd::Identity(unknowns, unknowns)).diagonal().cwiseSqrt();
  return fit;
}

// Block means of white residuals scatter by sigma / sqrt(n); what is beyond that wanders in time.
// Sigma is taken from neighbours in time, which wander together.
void refuse_moving_magnet(const Eigen::MatrixXd& residuals, Eigen::Index num_axes) {
  const auto count = static_cast<std::size_t>(residuals.rows());
  const Eigen::VectorXd variance =
      (residuals.bottomRows(residuals.rows() - 1) - residuals.topRows(residuals.rows() - 1))
          .colwise()
          .squaredNorm() /
      (2 * static_cast<double>(count - 1));
  const std::size_t blocks = std::min(kTimeBlocks, count / 10);
  if (blocks < 2) return;
  double chi2 = 0;
  double wander = 0;
  double uniform = 0;
  Eigen::Index worst = 0;
  double worst_size = 0;
  for (std::size_t block = 0; block < blocks; ++block) {
    const auto begin = static_cast<Eigen::Index>(block * count / blocks);
    const auto end = static_cast<Eigen::Index>((block + 1) * count / blocks);
    const Eigen::VectorXd mean = residuals.middleRows(begin, end - begin).colwise().mean();
    const Eigen::VectorXd white = variance / static_cast<double>(end - begin);
    chi2 += mean.cwiseAbs2().cwiseQuotient(white).sum();
    wander += mean.squaredNorm() - white.sum();
    for (Eigen::Index axis = 0; axis < num_axes; ++axis) {
      const Eigen::VectorXd of_axis = mean(Eigen::seq(axis, mean.size() - 1, num_axes));
      uniform += std::pow(of_axis.mean(), 2) * static_cast<double>(of_axis.size());
    }
    Eigen::Index at = 0;
    const double size = mean.cwiseAbs().maxCoeff(&at);
    if (size > worst_size) {
      worst_size = size;
      worst = at;
    }
  }
  const double samples = static_cast<double>(blocks) * static_cast<double>(residuals.cols());
  const double rms_wander = std::sqrt(std::max(0.0, wander / samples));
  if (chi2 / samples < kWanderingChi2 || rms_wander < kLeastWander) return;
  if (uniform > kUniformShare * wander) {
    throw CalibrationRefused(fmt::format(
        "the uniform background changed by {:.2g} uT rms during the log: keep the rig still and "
        "away from moving iron, and record again",
        rms_wander * 1e6));
  }
  throw CalibrationRefused(fmt::format(
      "the readings change by {:.2g} uT rms in ways that the currents do not explain, most ({:.2g} "
      "uT) at sensor {}: is the capsule or another magnet within the array's reach? Take it away "
      "and record again",
      rms_wander * 1e6, worst_size * 1e6, worst / num_axes));
}

void refuse_resting_magnet(const CoilCalibration& calibration, const RigConfiguration& rig) {
  Eigen::Vector3d background;
  const RigConfiguration calibrated = with_coils(rig, calibration, &background);
  Eigen::VectorXd pattern(calibration.offsets.size());
  const Eigen::Index num_axes = rig.hall_array.num_axes;
  const auto configured = rig.hall_array.resolved_sensors();
  for (Eigen::Index c = 0; c < pattern.size(); ++c) {
    const auto sensor = static_cast<std::size_t>(c / num_axes);
    const auto axis = static_cast<std::size_t>(c % num_axes);
    pattern(c) =
        calibrated.hall_array.sensors[sensor].offset[axis] - configured[sensor].offset[axis];
  }
  const double rms = std::sqrt(pattern.squaredNorm() / static_cast<double>(pattern.size()));
  if (rms < kLeastOffsetPattern * rig.hall_array.noise) return;
  const double explained = MagnetPoseFitter(rig).explained_by_magnet(pattern);
  if (explained < kMagnetShare) return;
  throw CalibrationRefused(fmt::format(
      "a magnet lies within the array's reach: it explains {:.0f} % of how the offsets ({:.2g} uT "
      "rms) vary over the array. Take the capsule away and record again",
      100 * explained, rms * 1e6));
}

}  // namespace

Eigen::VectorXd measure_current_noise(const Eigen::MatrixXd& samples) {
  constexpr double kThirdDifferenceGain = 4.47213595499958;  // sqrt(1 + 9 + 9 + 1)
  Eigen::VectorXd noise = Eigen::VectorXd::Zero(samples.cols());
  if (samples.rows() < 4) return noise;
  for (Eigen::Index coil = 0; coil < samples.cols(); ++coil) {
    std::vector<double> sizes;
    for (Eigen::Index i = 0; i + 3 < samples.rows(); ++i) {
      sizes.push_back(std::abs(samples(i + 3, coil) - 3 * samples(i + 2, coil) +
                               3 * samples(i + 1, coil) - samples(i, coil)));
    }
    noise(coil) = median(std::move(sizes)) / (kNormalMad * kThirdDifferenceGain);
  }
  return noise;
}

CoilCalibration calibrate_coils(const std::vector<CalibrationReading>& readings,
                                Eigen::Index num_axes, const Eigen::VectorXd& current_noise,
                                const std::optional<RigConfiguration>& rig) {
  const auto count = static_cast<Eigen::Index>(readings.size());
  if (count < kFewestReadings) {
    throw CalibrationRefused(
        fmt::format("the log has {} array readings with currents; at least {} are needed", count,
                    kFewestReadings));
  }
  const Eigen::Index num_channels = readings.front().field.size();
  const Eigen::Index num_coils = readings.front().currents.size();
  Eigen::MatrixXd design = Eigen::MatrixXd::Ones(count, num_coils + 1);
  Eigen::MatrixXd values(count, num_channels);
  Eigen::MatrixXd usable(count, num_channels);
  for (Eigen::Index i = 0; i < count; ++i) {
    const CalibrationReading& reading = readings[static_cast<std::size_t>(i)];
    design.row(i).head(num_coils) = reading.currents;
    values.row(i) = reading.field;
    for (Eigen::Index c = 0; c < num_channels; ++c) {
      usable(i, c) = reading.usable[static_cast<std::size_t>(c)] ? 1 : 0;
    }
  }
  CoilCalibration result;
  result.current_noise = current_noise;
  result.readings_used = static_cast<int>(count);
  result.drive = check_drive(design.leftCols(num_coils), current_noise);
  result.tesla_per_ampere.resize(num_channels, num_coils);
  result.tesla_per_ampere_std.resize(num_channels, num_coils);
  result.offsets.resize(num_channels);
  result.offset_stds.resize(num_channels);
  result.residual_rms.resize(num_channels);
  Eigen::MatrixXd residuals(count, num_channels);
  double outliers = 0;
  std::vector<std::string> mute;
  for (Eigen::Index c = 0; c < num_channels; ++c) {
    if (usable.col(c).sum() < static_cast<double>(kFewestReadings)) {
      mute.push_back(std::to_string(c));
      continue;
    }
    const ChannelFit fit = regress(design, values.col(c), usable.col(c), current_noise);
    result.tesla_per_ampere.row(c) = fit.solution.head(num_coils);
    result.tesla_per_ampere_std.row(c) = fit.deviation.head(num_coils);
    result.offsets(c) = fit.solution(num_coils);
    result.offset_stds(c) = fit.deviation(num_coils);
    result.residual_rms(c) = fit.rms;
    result.largest_attenuation = std::max(result.largest_attenuation, fit.attenuation);
    residuals.col(c) = fit.inliers.cwiseProduct(values.col(c) - design * fit.solution);
    outliers += usable.col(c).sum() - fit.inliers.sum();
  }
  if (!mute.empty()) {
    throw CalibrationRefused(fmt::format(
        "channels {} gave fewer than {} good readings: mend those sensors or record for longer",
        fmt::join(mute, ", "), kFewestReadings));
  }
  result.outlier_fraction = outliers / usable.sum();
  refuse_moving_magnet(residuals, num_axes);
  if (rig) refuse_resting_magnet(result, *rig);
  return result;
}

RigConfiguration with_coils(const RigConfiguration& rig, const CoilCalibration& calibration,
                            Eigen::Vector3d* background) {
  RigConfiguration result = rig;
  result.coils.tesla_per_ampere = calibration.tesla_per_ampere;
  result.coils.current_noise = calibration.current_noise.mean();
  result.hall_array.sensors = rig.hall_array.resolved_sensors();
  const Eigen::Index num_axes = rig.hall_array.num_axes;
  Eigen::MatrixXd responses(calibration.offsets.size(), 3);
  for (Eigen::Index c = 0; c < responses.rows(); ++c) {
    responses.row(c) =
        result.hall_array.sensors[static_cast<std::size_t>(c / num_axes)].response.row(c %
                                                                                       num_axes);
  }
  *background = uniform_field(responses, calibration.offsets);
  const Eigen::VectorXd offsets = calibration.offsets - responses * *background;
  for (Eigen::Index c = 0; c < responses.rows(); ++c) {
    result.hall_array.sensors[static_cast<std::size_t>(c / num_axes)]
        .offset[static_cast<std::size_t>(c % num_axes)] = offsets(c);
  }
  result.hall_array.offset_std = std::sqrt(calibration.offset_stds.squaredNorm() /
                                           static_cast<double>(calibration.offset_stds.size()));
  return result;
}

}  // namespace gastronaut

#include "calibrate/joint_array_fit.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "calibrate/robust_weight.hpp"
#include "calibrate/uniform_field.hpp"
#include "geometry/se3.hpp"
#include "magnetics/axial_magnet.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut {
namespace {

constexpr Eigen::Index kPoseSize = 5;    // position, then the axis in its tangent plane
constexpr Eigen::Index kGlobalSize = 4;  // relative moment, background
constexpr Eigen::Index kOffset = 3;      // a channel's parameters: response, offset, coil row error
constexpr Eigen::Index kCoilError = 4;
constexpr int kMostIterations = 40;
constexpr double kLeastDamping = 1e-7;  // the start is near: almost Gauss-Newton
constexpr double kRaisedDamping = 1e-3;
constexpr double kHopelessDamping = 1e6;
constexpr double kConvergedDecrease = 1e-7;  // relative, of the cost: far below one sigma
constexpr double kNormalMad = 0.67449;       // median of |standard normal|
constexpr double kLargestStep = 0.03;        // metres; the field changes its shape beyond
// One sigma of a pose that is not known, about its start: keeps fixes that the readings hardly
// determine from running away, far too weak to be felt by others.
constexpr double kUnknownPosition = 0.1;   // metres
constexpr double kUnknownAxis = 1;         // radians
constexpr Eigen::Index kColumnBlock = 96;  // columns of the Schur complement made at a time

}  // namespace

struct JointArrayFit::Decoded {
  Eigen::MatrixXd responses;  // num_channels x 3
  Eigen::VectorXd offsets;
  Eigen::MatrixXd coil_matrix;
  double moment;
  Eigen::Vector3d background;
};

namespace {

// Maps a response error in sigmas to physical units: gain along the row, alignment across it.
Eigen::Matrix3d response_scale(const Eigen::RowVector3d& response, const ArrayPriors& priors) {
  const double norm = response.norm();
  const Eigen::Vector3d along = response.transpose() / norm;
  const Eigen::Matrix3d projection = along * along.transpose();
  return norm * (priors.gain_std * projection +
                 priors.alignment_std * (Eigen::Matrix3d::Identity() - projection));
}

}  // namespace

JointArrayFit::JointArrayFit(const RigConfiguration& rig, const ArrayPriors& priors,
                             std::vector<CalibrationReading> readings,
                             std::vector<MagnetPose> starts)
    : rig_(rig),
      priors_(priors),
      sensors_(rig.hall_array.resolved_sensors()),
      readings_(std::move(readings)),
      starts_(std::move(starts)),
      num_axes_(rig.hall_array.num_axes),
      num_channels_(static_cast<Eigen::Index>(sensors_.size()) * num_axes_),
      num_coils_(rig.coils.tesla_per_ampere.cols()),
      per_channel_(kCoilError + std::min(num_coils_, num_axes_ == 1 ? num_coils_ : num_axes_)),
      per_reading_(kPoseSize + num_coils_),
      num_array_(num_channels_ * per_channel_ + kGlobalSize),
      octupole_ratio_(octupole_ratio(rig.magnet.shape())) {
  const Eigen::MatrixXd& matrix = rig.coils.tesla_per_ampere;
  for (Eigen::Index c = 0; c < num_channels_ && num_coils_ > 0; ++c) {
    const Eigen::Index axis = c % num_axes_;
    Eigen::MatrixXd patterns;
    if (num_axes_ == 1) {
      const double across =
          priors.alignment_std * matrix.row(c).norm() / std::sqrt(static_cast<double>(num_coils_));
      patterns =
          (priors.gain_std * matrix.row(c).cwiseAbs().array() + across).matrix().asDiagonal();
    } else {
      patterns = priors.alignment_std * matrix.middleRows(c - axis, num_axes_);
      patterns.row(axis) = priors.gain_std * matrix.row(c);
    }
    coil_errors_.push_back(std::move(patterns));
  }
  state_.array = Eigen::VectorXd::Zero(num_array_);
  state_.poses = starts_;
  state_.current_errors =
      Eigen::MatrixXd::Zero(num_coils_, static_cast<Eigen::Index>(readings_.size()));
}

JointArrayFit::Decoded JointArrayFit::decode(const Eigen::VectorXd& array) const {
  Decoded result;
  result.responses.resize(num_channels_, 3);
  result.offsets.resize(num_channels_);
  result.coil_matrix = rig_.coils.tesla_per_ampere;
  for (Eigen::Index c = 0; c < num_channels_; ++c) {
    const HallSensorConfiguration& sensor = sensors_[static_cast<std::size_t>(c / num_axes_)];
    const Eigen::Index axis = c % num_axes_;
    const Eigen::Index at = c * per_channel_;
    const Eigen::RowVector3d nominal = sensor.response.row(axis);
    result.responses.row(c) =
        nominal + (response_scale(nominal, priors_) * array.segment<3>(at)).transpose();
    result.offsets(c) =
        sensor.offset[static_cast<std::size_t>(axis)] + priors_.offset_std * array(at + kOffset);
    if (num_coils_ > 0) {
      result.coil_matrix.row(c) +=
          array.segment(at + kCoilError, per_channel_ - kCoilError).transpose() *
          coil_errors_[static_cast<std::size_t>(c)];
    }
  }
  const auto global = array.tail<kGlobalSize>();
  result.moment = rig_.magnet.moment + rig_.magnet.moment_std * global(0);
  result.background = rig_.magnetic_localizer.background_std * global.tail<3>();
  return result;
}

JointArrayFit::PosePrior JointArrayFit::pose_prior(std::size_t t) const {
  if (const auto& known = readings_[t].known_pose) {
    return {*known, priors_.known_position_std, priors_.known_axis_std};
  }
  return {starts_[t], kUnknownPosition, kUnknownAxis};
}

JointArrayFit::Rows JointArrayFit::linearize(const Decoded& array, const MagnetPose& pose,
                                             const Eigen::VectorXd& current_error,
                                             const CalibrationReading& reading) const {
  Rows rows;
  rows.residual = Eigen::VectorXd::Zero(num_channels_);
  rows.by_local = Eigen::MatrixXd::Zero(num_channels_, per_reading_);
  rows.by_channel = Eigen::MatrixXd::Zero(num_channels_, per_channel_);
  rows.by_global = Eigen::MatrixXd::Zero(num_channels_, kGlobalSize);
  const double per_sigma = 1 / rig_.hall_array.noise;
  const Eigen::Matrix<double, 3, 2> tangent = perpendicular_basis(pose.axis);
  Eigen::VectorXd currents;
  if (num_coils_ > 0) currents = reading.currents + rig_.coils.current_noise * current_error;
  for (std::size_t s = 0; s < sensors_.size(); ++s) {
    const AxialMagnetDerivatives magnet = axial_magnet_derivatives(
        sensors_[s].position - pose.position, array.moment * pose.axis, octupole_ratio_);
    const Eigen::Matrix<double, 3, 2> by_axis = array.moment * magnet.by_moment * tangent;
    for (Eigen::Index axis = 0; axis < num_axes_; ++axis) {
      const Eigen::Index c = static_cast<Eigen::Index>(s) * num_axes_ + axis;
      if (!reading.usable[static_cast<std::size_t>(c)]) continue;
      const Eigen::RowVector3d response = array.responses.row(c);
      const Eigen::Vector3d field = magnet.field + array.background;
      double expected = response * field + array.offsets(c);
      rows.by_local.block<1, 3>(c, 0) = -response * magnet.by_offset;
      rows.by_local.block<1, 2>(c, 3) = response * by_axis;
      rows.by_channel.block<1, 3>(c, 0) =
          field.transpose() * response_scale(sensors_[s].response.row(axis), priors_);
      rows.by_channel(c, kOffset) = priors_.offset_std;
      if (num_coils_ > 0) {
        expected += array.coil_matrix.row(c).dot(currents);
        rows.by_local.row(c).tail(num_coils_) = rig_.coils.current_noise * array.coil_matrix.row(c);
        rows.by_channel.row(c).tail(per_channel_ - kCoilError) =
            (coil_errors_[static_cast<std::size_t>(c)] * currents).transpose();
      }
      rows.by_global(c, 0) = rig_.magnet.moment_std / array.moment * response.dot(magnet.field);
      rows.by_global.block<1, 3>(c, 1) = rig_.magnetic_localizer.background_std * response;
      rows.residual(c) = (reading.field(c) - expected) * per_sigma;
    }
  }
  rows.by_local *= per_sigma;
  rows.by_channel *= per_sigma;
  rows.by_global *= per_sigma;
  return rows;
}

double JointArrayFit::cost(const State& state) const {
  const Decoded array = decode(state.array);
  std::vector<double> costs(readings_.size());
  parallel_for_chunks(readings_.size(), 16, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) {
      const Eigen::VectorXd error = state.current_errors.col(static_cast<Eigen::Index>(t));
      const MagnetPose& pose = state.poses[t];
      double total = error.squaredNorm();
      for (const double residual : linearize(array, pose, error, readings_[t]).residual) {
        total += robust_loss(residual);
      }
      const PosePrior prior = pose_prior(t);
      total += ((pose.position - prior.pose.position) / prior.position_std).squaredNorm();
      total += (perpendicular_basis(prior.pose.axis).transpose() * pose.axis / prior.axis_std)
                   .squaredNorm();
      costs[t] = total;
    }
  });
  double total = state.array.squaredNorm();
  for (const double reading : costs) total += reading;
  return total;
}

void JointArrayFit::assemble(const State& state, double damping) {
  const Decoded array = decode(state.array);
  const Eigen::Index num_local = per_reading_ * static_cast<Eigen::Index>(readings_.size());
  reduced_ = Eigen::MatrixXd::Zero(num_array_, num_array_);
  reduced_.diagonal().setOnes();
  gradient_ = -state.array;
  eliminated_ = Eigen::MatrixXd::Zero(num_local, num_array_);
  local_right_.resize(num_local);
  local_factors_.assign(readings_.size(), {});
  for (std::size_t t = 0; t < readings_.size(); ++t) {
    const Eigen::VectorXd error = state.current_errors.col(static_cast<Eigen::Index>(t));
    const Rows rows = linearize(array, state.poses[t], error, readings_[t]);
    const Eigen::VectorXd weight = rows.residual.unaryExpr(&robust_weight);
    const Eigen::MatrixXd weighted = weight.asDiagonal() * rows.by_local;
    Eigen::MatrixXd local = weighted.transpose() * rows.by_local;
    Eigen::VectorXd right = weighted.transpose() * rows.residual;
    local.diagonal().tail(num_coils_).array() += 1;
    right.tail(num_coils_) -= error;
    const PosePrior prior = pose_prior(t);
    const MagnetPose& pose = state.poses[t];
    const double position = 1 / std::pow(prior.position_std, 2);
    local.diagonal().head<3>().array() += position;
    right.head<3>() -= position * (pose.position - prior.pose.position);
    const Eigen::Matrix<double, 2, 3> off_axis =
        perpendicular_basis(prior.pose.axis).transpose() / prior.axis_std;
    const Eigen::Matrix2d axis_by_step = off_axis * perpendicular_basis(pose.axis);
    local.block<2, 2>(3, 3) += axis_by_step.transpose() * axis_by_step;
    right.segment<2>(3) -= axis_by_step.transpose() * off_axis * pose.axis;
    local.diagonal() *= 1 + damping;
    const Eigen::LLT<Eigen::MatrixXd> factor(local);
    local_factors_[t] = factor.matrixL();

    const Eigen::Index first = static_cast<Eigen::Index>(t) * per_reading_;
    auto coupling = eliminated_.middleRows(first, per_reading_);
    const Eigen::Index globals = num_array_ - kGlobalSize;
    for (Eigen::Index c = 0; c < num_channels_; ++c) {
      const Eigen::Index at = c * per_channel_;
      const Eigen::RowVectorXd by_channel = rows.by_channel.row(c);
      coupling.middleCols(at, per_channel_) = weighted.row(c).transpose() * by_channel;
      reduced_.block(at, at, per_channel_, per_channel_) +=
          weight(c) * by_channel.transpose() * by_channel;
      reduced_.block(globals, at, kGlobalSize, per_channel_) +=
          weight(c) * rows.by_global.row(c).transpose() * by_channel;
      gradient_.segment(at, per_channel_) += weight(c) * rows.residual(c) * by_channel.transpose();
    }
    coupling.rightCols<kGlobalSize>() = weighted.transpose() * rows.by_global;
    reduced_.bottomRightCorner<kGlobalSize, kGlobalSize>() +=
        rows.by_global.transpose() * weight.asDiagonal() * rows.by_global;
    gradient_.tail<kGlobalSize>() +=
        rows.by_global.transpose() * weight.asDiagonal() * rows.residual;
    const auto lower = local_factors_[t].triangularView<Eigen::Lower>();
    lower.solveInPlace(coupling);
    local_right_.segment(first, per_reading_) = lower.solve(right);
  }
  reduced_.diagonal() *= 1 + damping;
  gradient_ -= eliminated_.transpose() * local_right_;
  // The bulk of the work. Column blocks are independent of each other: the same sums in the same
  // order, however many threads there are.
  const auto columns = static_cast<std::size_t>(num_array_);
  parallel_for_chunks(columns, kColumnBlock, [&](std::size_t begin, std::size_t end) {
    const auto from = static_cast<Eigen::Index>(begin);
    const auto width = static_cast<Eigen::Index>(end - begin);
    reduced_.block(from, from, num_array_ - from, width).noalias() -=
        eliminated_.rightCols(num_array_ - from).transpose() * eliminated_.middleCols(from, width);
  });
}

JointArrayFit::State JointArrayFit::stepped(const State& state) const {
  const Eigen::VectorXd step = reduced_.selfadjointView<Eigen::Lower>().llt().solve(gradient_);
  State next = state;
  next.array += step;
  const Eigen::VectorXd right = local_right_ - eliminated_ * step;
  for (std::size_t t = 0; t < readings_.size(); ++t) {
    Eigen::VectorXd local = local_factors_[t].triangularView<Eigen::Lower>().transpose().solve(
        right.segment(static_cast<Eigen::Index>(t) * per_reading_, per_reading_));
    const double length = local.head<3>().norm();
    if (length > kLargestStep) local *= kLargestStep / length;
    MagnetPose& pose = next.poses[t];
    pose.position += local.head<3>();
    pose.axis = (pose.axis + perpendicular_basis(pose.axis) * local.segment<2>(3)).normalized();
    next.current_errors.col(static_cast<Eigen::Index>(t)) += local.tail(num_coils_);
  }
  return next;
}

bool JointArrayFit::solve(const std::function<void(double)>& progress) {
  cost_ = cost(state_);
  double damping = kLeastDamping;
  bool converged = false;
  for (int iteration = 0; !converged; ++iteration) {
    if (iteration == kMostIterations || damping > kHopelessDamping) return false;
    // Most logs converge in half a dozen iterations; the last part is the covariance.
    progress(1 - std::pow(0.7, iteration));
    assemble(state_, damping);
    State next = stepped(state_);
    const double next_cost = cost(next);
    // At the minimum the last digits of the cost go either way.
    const double small = kConvergedDecrease * cost_;
    if (next_cost <= cost_ + small) {
      converged = cost_ - next_cost <= small;
      state_ = std::move(next);
      cost_ = next_cost;
      damping = std::max(damping / 10, kLeastDamping);
    } else {
      damping = std::max(damping * 10, kRaisedDamping);
    }
  }
  assemble(state_, 0);
  covariance_ = reduced_.selfadjointView<Eigen::Lower>().llt().solve(
      Eigen::MatrixXd::Identity(num_array_, num_array_));
  progress(1);
  return true;
}

void JointArrayFit::move_pose(std::size_t reading, const MagnetPose& pose) {
  starts_[reading] = pose;
  state_.poses[reading] = pose;
  state_.current_errors.col(static_cast<Eigen::Index>(reading)).setZero();
}

RigConfiguration JointArrayFit::rig() const {
  const Decoded array = decode(state_.array);
  RigConfiguration result = rig_;
  result.magnet.moment = array.moment;
  result.coils.tesla_per_ampere = array.coil_matrix;
  result.hall_array.sensors = sensors_;
  for (std::size_t s = 0; s < sensors_.size(); ++s) {
    HallSensorConfiguration& sensor = result.hall_array.sensors[s];
    const Eigen::Index first = static_cast<Eigen::Index>(s) * num_axes_;
    sensor.response = array.responses.middleRows(first, num_axes_);
    for (Eigen::Index axis = 0; axis < num_axes_; ++axis) {
      sensor.offset[static_cast<std::size_t>(axis)] = array.offsets(first + axis);
    }
  }
  return result;
}

Eigen::Vector3d JointArrayFit::background() const { return decode(state_.array).background; }

// Priors count as data: what remains are the readings, less the unknowns that have no prior.
double JointArrayFit::chi2_per_dof() const {
  double dof = 0;
  for (const CalibrationReading& reading : readings_) {
    dof += static_cast<double>(std::count(reading.usable.begin(), reading.usable.end(), true));
    if (!reading.known_pose) dof -= static_cast<double>(kPoseSize);
  }
  return cost_ / dof;
}

double JointArrayFit::residual_scale() const {
  const Decoded array = decode(state_.array);
  std::vector<double> sizes;
  for (std::size_t t = 0; t < readings_.size(); ++t) {
    const Rows rows =
        linearize(array, state_.poses[t], state_.current_errors.col(static_cast<Eigen::Index>(t)),
                  readings_[t]);
    for (Eigen::Index c = 0; c < num_channels_; ++c) {
      if (readings_[t].usable[static_cast<std::size_t>(c)]) {
        sizes.push_back(std::abs(rows.residual(c)));
      }
    }
  }
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  return *middle / kNormalMad;
}

std::vector<JointArrayFit::ChannelDeviation> JointArrayFit::channel_deviations() const {
  // Derivative of the readings without magnet and currents, and their covariance. A pattern that a
  // uniform field makes as well is not an offset: it is projected out.
  const Decoded array = decode(state_.array);
  Eigen::MatrixXd by_array = Eigen::MatrixXd::Zero(num_channels_, num_array_);
  for (Eigen::Index c = 0; c < num_channels_; ++c) {
    const Eigen::RowVector3d nominal =
        sensors_[static_cast<std::size_t>(c / num_axes_)].response.row(c % num_axes_);
    by_array.block<1, 3>(c, c * per_channel_) =
        array.background.transpose() * response_scale(nominal, priors_);
    by_array(c, c * per_channel_ + kOffset) = priors_.offset_std;
    by_array.block<1, 3>(c, num_array_ - 3) =
        rig_.magnetic_localizer.background_std * array.responses.row(c);
  }
  Eigen::MatrixXd offsets = by_array * covariance_ * by_array.transpose();
  Eigen::MatrixXd responses(num_channels_, 3);
  for (Eigen::Index c = 0; c < num_channels_; ++c) {
    responses.row(c) =
        sensors_[static_cast<std::size_t>(c / num_axes_)].response.row(c % num_axes_);
  }
  Eigen::MatrixXd projection = Eigen::MatrixXd::Identity(num_channels_, num_channels_);
  for (Eigen::Index c = 0; c < num_channels_; ++c) {
    projection.col(c) -= responses * uniform_field(responses, projection.col(c));
  }
  offsets = projection * offsets * projection.transpose();

  std::vector<ChannelDeviation> deviations;
  for (Eigen::Index c = 0; c < num_channels_; ++c) {
    const Eigen::RowVector3d nominal =
        sensors_[static_cast<std::size_t>(c / num_axes_)].response.row(c % num_axes_);
    const Eigen::Matrix3d scale = response_scale(nominal, priors_) / nominal.norm();
    const Eigen::Matrix3d response =
        scale * covariance_.block<3, 3>(c * per_channel_, c * per_channel_) * scale.transpose();
    const Eigen::RowVector3d along = nominal.normalized();
    const double gain = along * response * along.transpose();
    deviations.push_back({std::sqrt(gain), std::sqrt((response.trace() - gain) / 2),
                          std::sqrt(std::max(0.0, offsets(c, c)))});
  }
  return deviations;
}

double JointArrayFit::moment_deviation() const {
  const Eigen::Index at = num_array_ - kGlobalSize;
  return rig_.magnet.moment_std * std::sqrt(covariance_(at, at));
}

JointArrayFit::InducedError JointArrayFit::induced_error(std::size_t t) const {
  const Rows rows =
      linearize(decode(state_.array), state_.poses[t],
                state_.current_errors.col(static_cast<Eigen::Index>(t)), readings_[t]);
  // The fix that is asked about estimates pose and background, and knows nothing of the rest.
  Eigen::MatrixXd by_fix(num_channels_, kPoseSize + 3);
  by_fix << rows.by_local.leftCols<kPoseSize>(), rows.by_global.rightCols<3>();
  const Eigen::MatrixXd fix =
      (by_fix.transpose() * by_fix).ldlt().solve(by_fix.transpose()).topRows<kPoseSize>();
  Eigen::MatrixXd effect(kPoseSize, num_array_);
  for (Eigen::Index c = 0; c < num_channels_; ++c) {
    effect.middleCols(c * per_channel_, per_channel_) = fix.col(c) * rows.by_channel.row(c);
  }
  effect.rightCols<kGlobalSize>() = fix * rows.by_global;
  effect.rightCols<3>().setZero();  // the background is the fix's own
  const Eigen::MatrixXd prior = effect * effect.transpose();
  const Eigen::MatrixXd posterior = effect * covariance_ * effect.transpose();
  const auto deviation = [](const Eigen::MatrixXd& covariance, Eigen::Index from,
                            Eigen::Index size) {
    return std::sqrt(covariance.diagonal().segment(from, size).sum());
  };
  return {deviation(prior, 0, 3), deviation(prior, 3, 2), deviation(posterior, 0, 3),
          deviation(posterior, 3, 2)};
}

}  // namespace gastronaut

#include "evaluate/cramer_rao.hpp"

#include <Eigen/Cholesky>
#include <limits>

#include "magnetics/axial_magnet.hpp"

namespace gastronaut::evaluation {
namespace {
// Unknowns: position, two rotations of the axis, background, moment, then one a coil current.
constexpr Eigen::Index kBackground = 5;
constexpr Eigen::Index kMoment = 8;
constexpr Eigen::Index kCurrents = 9;

double square(double x) { return x * x; }
}  // namespace

CramerRaoBound::CramerRaoBound(const RigConfiguration& configuration, Noise noise)
    : sensors_(configuration.hall_array.resolved_sensors()),
      moment_(configuration.magnet.moment),
      octupole_ratio_(octupole_ratio(configuration.magnet.shape())),
      noise_variance_(square(configuration.hall_array.noise)),
      background_std_(configuration.magnetic_localizer.background_std) {
  if (configuration.magnetic_localizer.estimate_moment) {
    moment_std_ = configuration.magnet.moment_std;
  }
  if (noise == Noise::kSensorOnly) return;
  noise_variance_ += square(configuration.hall_array.offset_std);
  gain_std_ = configuration.hall_array.gain_std;
  alignment_std_ = configuration.hall_array.alignment_std;
  current_effect_ = configuration.coils.tesla_per_ampere * configuration.coils.current_noise;
}

Matrix5d CramerRaoBound::covariance(const Eigen::Vector3d& position, const Eigen::Vector3d& axis,
                                    std::span<const int> unused) const {
  const Eigen::Index unknowns = kCurrents + current_effect_.cols();
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(unknowns, unknowns);
  const Eigen::Matrix<double, 3, 2> basis = perpendicular_basis(axis);
  const Eigen::Matrix<double, 3, 2> axis_by_rotation = -skew(axis) * basis;
  auto next_unused = unused.begin();
  int channel = 0;
  for (const HallSensorConfiguration& sensor : sensors_) {
    const AxialMagnetDerivatives magnet =
        axial_magnet_derivatives(sensor.position - position, moment_ * axis, octupole_ratio_);
    Eigen::Matrix<double, 3, kCurrents> field_by_unknowns;
    field_by_unknowns << -magnet.by_offset, moment_ * magnet.by_moment * axis_by_rotation,
        Eigen::Matrix3d::Identity(), magnet.by_moment * axis;
    std::vector<Eigen::Index> used;
    const int first_channel = channel;
    for (Eigen::Index measured = 0; measured < sensor.response.rows(); ++measured, ++channel) {
      if (next_unused != unused.end() && *next_unused == channel) {
        ++next_unused;
      } else {
        used.push_back(measured);
      }
    }
    if (used.empty()) continue;
    const Eigen::MatrixXd response = sensor.response(used, Eigen::all);
    Eigen::MatrixXd jacobian(response.rows(), unknowns);
    jacobian.leftCols<kCurrents>() = response * field_by_unknowns;
    if (current_effect_.cols() > 0) {
      jacobian.rightCols(current_effect_.cols()) =
          current_effect_.middleRows(first_channel, sensor.response.rows())(used, Eigen::all);
    }
    // Gains err axis by axis; a misalignment turns all axes of a sensor together.
    const Eigen::MatrixXd turned = response * skew(magnet.field);
    Eigen::MatrixXd covariance = square(alignment_std_) * turned * turned.transpose();
    covariance.diagonal().array() +=
        noise_variance_ + square(gain_std_) * (response * magnet.field).array().square();
    const Eigen::MatrixXd whitened = covariance.llt().matrixL().solve(jacobian);
    information.selfadjointView<Eigen::Lower>().rankUpdate(whitened.transpose());
  }
  information.diagonal().segment<3>(kBackground).array() += 1 / square(background_std_);
  information.diagonal().tail(current_effect_.cols()).array() += 1;
  if (moment_std_ > 0) {
    information(kMoment, kMoment) += 1 / square(moment_std_);
  } else {
    information.row(kMoment).setZero();
    information.col(kMoment).setZero();
    information(kMoment, kMoment) = 1;
  }
  // Tesla, metres and radians differ by many orders: scale to a unit diagonal before factoring.
  const Eigen::VectorXd scale = information.diagonal().cwiseSqrt().cwiseInverse();
  if (!scale.allFinite()) {
    return Matrix5d::Constant(std::numeric_limits<double>::infinity());
  }
  const Eigen::MatrixXd scaled = scale.asDiagonal() *
                                 Eigen::MatrixXd(information.selfadjointView<Eigen::Lower>()) *
                                 scale.asDiagonal();
  const Eigen::LLT<Eigen::MatrixXd> factor(scaled);
  if (factor.info() != Eigen::Success) {
    return Matrix5d::Constant(std::numeric_limits<double>::infinity());
  }
  const Eigen::MatrixXd inverse =
      factor.solve(Eigen::MatrixXd::Identity(unknowns, unknowns).leftCols<5>());
  return scale.head<5>().asDiagonal() * inverse.topRows<5>() * scale.head<5>().asDiagonal();
}

}  // namespace gastronaut::evaluation

#include "sensor_fusion/capsule_belief.hpp"

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>
#include <numbers>

namespace gastronaut::fusion {
namespace {

// Of the direct sums of noise, never of signals: keeps covariances positive definite where two
// measurements all but repeat each other.
constexpr double kLeastVariance = 1e-18;

using Matrix63 = Eigen::Matrix<double, 6, 3>;

}  // namespace

void CapsuleBelief::predict(double elapsed, const BeliefModel& model,
                            const Matrix6d& bias_covariance) {
  const double keeps_velocity = std::exp(-elapsed / model.velocity_memory);
  const double keeps_turn = std::exp(-elapsed / model.turn_memory);
  const double reach = model.velocity_memory * (1 - keeps_velocity);
  const double turn_reach = model.turn_memory * (1 - keeps_turn);
  const double bias_rate = velocity.norm() / model.bias_length + 1 / model.bias_time;
  const double keeps_bias = std::exp(-elapsed * bias_rate);

  position += velocity * reach;
  rig_R_camera = (so3_exp(turn * turn_reach) * rig_R_camera).normalized();
  velocity *= keeps_velocity;
  turn *= keeps_turn;
  position_bias *= keeps_bias;
  axis_bias *= keeps_bias;

  // covariance <- F covariance F^T, F differing from the identity in a few blocks only: rows first,
  // then columns.
  ErrorMatrix& c = covariance;
  const Eigen::Matrix3d camera_R_rig = rig_R_camera.conjugate().toRotationMatrix();
  c.middleRows<3>(kPosition) += reach * c.middleRows<3>(kVelocity);
  c.middleRows<3>(kRotation) += turn_reach * camera_R_rig * c.middleRows<3>(kTurn);
  c.middleRows<3>(kVelocity) *= keeps_velocity;
  c.middleRows<3>(kTurn) *= keeps_turn;
  c.middleRows<6>(kPositionBias) *= keeps_bias;
  c.middleCols<3>(kPosition) += reach * c.middleCols<3>(kVelocity);
  c.middleCols<3>(kRotation) += turn_reach * c.middleCols<3>(kTurn) * camera_R_rig.transpose();
  c.middleCols<3>(kVelocity) *= keeps_velocity;
  c.middleCols<3>(kTurn) *= keeps_turn;
  c.middleCols<6>(kPositionBias) *= keeps_bias;

  const auto drive = [&](int place, int rate, double reached, double density,
                         const Eigen::Matrix3d& frame) {
    const double q = density * density * elapsed;
    c.block<3, 3>(place, place).diagonal().array() += q * reached * reached / 3;
    c.block<3, 3>(place, rate) += q * reached / 2 * frame;
    c.block<3, 3>(rate, place) += q * reached / 2 * frame.transpose();
    c.block<3, 3>(rate, rate).diagonal().array() += q;
  };
  drive(kPosition, kVelocity, reach, model.acceleration_std, Eigen::Matrix3d::Identity());
  drive(kRotation, kTurn, turn_reach, model.angular_acceleration_std, camera_R_rig);
  c.block<6, 6>(kPositionBias, kPositionBias) += (1 - keeps_bias * keeps_bias) * bias_covariance;

  // A roll that has been open for long is spread over the circle, not wider.
  constexpr double kUniformRoll = std::numbers::pi * std::numbers::pi / 3;
  const ErrorVector roll = c.middleCols<3>(kRotation) * magnet_axis;
  const double variance = magnet_axis.dot(roll.segment<3>(kRotation));
  if (variance > kUniformRoll) {
    c.noalias() -= (1 - kUniformRoll / variance) / variance * roll * roll.transpose();
  }
}

Innovation CapsuleBelief::observe_magnet(const MagneticFix& fix, double scatter,
                                         bool with_axis) const {
  const int size = with_axis ? 5 : 3;
  Innovation innovation;
  innovation.residual.resize(size);
  innovation.jacobian.setZero(size, kErrorSize);
  innovation.noise = scatter * fix.covariance.topLeftCorner(size, size);

  innovation.residual.head<3>() = fix.position - position - position_bias - velocity * time_offset;
  auto place = innovation.jacobian.topRows<3>();
  place.middleCols<3>(kPosition).setIdentity();
  place.middleCols<3>(kPositionBias).setIdentity();
  place.middleCols<3>(kVelocity) = time_offset * Eigen::Matrix3d::Identity();
  place.col(kTimeOffset) = velocity;
  if (!with_axis) return innovation;

  const Eigen::Vector3d turned = turn * time_offset + axis_bias;
  const Eigen::Quaterniond seen_R_camera = so3_exp(turned) * rig_R_camera;
  const Eigen::Vector3d axis = seen_R_camera * magnet_axis;
  const Eigen::Quaterniond between = Eigen::Quaterniond::FromTwoVectors(axis, fix.axis);
  // The covariance's basis, carried over to the expected axis: seen from there the roll about the
  // axis has no effect at all. With the measured axis' own basis it would seem to have one, as
  // large as the noise, and be taken for known in the end.
  const Eigen::Matrix<double, 2, 3> tangent =
      (between.conjugate().toRotationMatrix() * perpendicular_basis(fix.axis)).transpose();
  innovation.residual.tail<2>() = tangent * so3_log(between);
  auto rotation = innovation.jacobian.bottomRows<2>();
  const Eigen::Matrix<double, 2, 3> turned_by = tangent * seen_R_camera.toRotationMatrix();
  rotation.middleCols<3>(kRotation) = turned_by;
  rotation.middleCols<3>(kAxisBias) = tangent;
  rotation.middleCols<2>(kMagnetAxis) = turned_by * perpendicular_basis(magnet_axis);
  // Not of the time offset: the turn is so uncertain that its errors would seem to tell of the
  // roll.
  return innovation;
}

// Linearised at the rotation and place that vision has measured, which do not wander with the
// estimate.
Innovation CapsuleBelief::observe_camera(const SE3& map_T_camera, const Matrix6d& noise,
                                         bool rotation_only) const {
  const Eigen::Quaterniond expected = rig_T_map.rotation.conjugate() * rig_R_camera;
  const Eigen::Vector3d rotation = so3_log(expected.conjugate() * map_T_camera.rotation);
  Innovation innovation;
  if (rotation_only) {
    innovation.residual = rotation;
    innovation.jacobian.setZero(3, kErrorSize);
    innovation.jacobian.middleCols<3>(kRotation).setIdentity();
    innovation.noise = noise.bottomRightCorner<3, 3>();
    return innovation;
  }
  const Eigen::Matrix3d map_R_rig = rig_T_map.rotation.conjugate().toRotationMatrix();
  const Eigen::Matrix3d map_R_camera = map_T_camera.rotation.toRotationMatrix();
  const Eigen::Matrix3d camera_R_map = map_R_camera.transpose();
  const Eigen::Vector3d seen = map_scale * map_T_camera.translation;
  const Eigen::Vector3d arm = map_R_rig * (rig_T_camera().translation - rig_T_map.translation);
  innovation.residual.resize(6);
  innovation.residual << camera_R_map * (seen - arm), rotation;
  innovation.jacobian.setZero(6, kErrorSize);
  auto translation_rows = innovation.jacobian.topRows<3>();
  translation_rows.middleCols<3>(kPosition) = camera_R_map * map_R_rig;
  translation_rows.middleCols<3>(kRotation) = skew(magnet_position);
  translation_rows.middleCols<3>(kMagnetPosition) = -Eigen::Matrix3d::Identity();
  translation_rows.middleCols<3>(kMapPosition) = -camera_R_map;
  translation_rows.middleCols<3>(kMapRotation) = camera_R_map * skew(seen);
  translation_rows.col(kMapScale) = -camera_R_map * seen;
  auto rotation_rows = innovation.jacobian.bottomRows<3>();
  rotation_rows.middleCols<3>(kRotation).setIdentity();
  rotation_rows.middleCols<3>(kMapRotation) = -camera_R_map;
  innovation.noise = noise;
  return innovation;
}

Gain CapsuleBelief::weigh(const Innovation& innovation) const {
  Gain gain;
  gain.half.noalias() = covariance * innovation.jacobian.transpose();
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, Innovation::kMost, Innovation::kMost>
      sum = innovation.noise;
  sum.noalias() += innovation.jacobian * gain.half;
  sum.diagonal().array() += kLeastVariance;
  const Eigen::LLT<decltype(sum)> cholesky(sum);
  if (cholesky.info() != Eigen::Success) {
    gain.half.setZero();
    gain.whitened.setZero(sum.rows());
    gain.log_density = -std::numeric_limits<double>::infinity();
    return gain;
  }
  gain.whitened = cholesky.matrixL().solve(innovation.residual);
  // half = covariance H^T L^-T, so that covariance -= half half^T stays symmetric.
  cholesky.matrixU().solveInPlace<Eigen::OnTheRight>(gain.half);
  gain.chi2 = gain.whitened.squaredNorm();
  const decltype(sum) lower = cholesky.matrixL();
  gain.log_det = 2 * lower.diagonal().array().log().sum() +
                 static_cast<double>(sum.rows()) * std::log(2 * std::numbers::pi);
  gain.log_density = -0.5 * (gain.chi2 + gain.log_det);
  return gain;
}

void CapsuleBelief::update(const Gain& gain) {
  ErrorVector error = gain.half * gain.whitened;
  const Eigen::Matrix<double, kCalibrationSize, kCalibrationSize> calibration =
      covariance.bottomRightCorner<kCalibrationSize, kCalibrationSize>();
  covariance.noalias() -= gain.half * gain.half.transpose();
  if (!learns_calibration) {
    covariance.bottomRightCorner<kCalibrationSize, kCalibrationSize>() = calibration;
    error.tail<kCalibrationSize>().setZero();
  }
  add(error);
}

void CapsuleBelief::let_map_drift(const Matrix6d& noise, double scale_variance) {
  // The map turns, and grows, about where the camera is: elsewhere it moves with that.
  const Eigen::Quaterniond map_R_rig = rig_T_map.rotation.conjugate();
  const Eigen::Matrix3d frame = (map_R_rig * rig_R_camera).toRotationMatrix();
  const Eigen::Vector3d arm = map_R_rig * (rig_T_camera().translation - rig_T_map.translation);
  Eigen::Matrix<double, 7, 7> driver = Eigen::Matrix<double, 7, 7>::Zero();
  Eigen::Matrix<double, 7, 7> spread = Eigen::Matrix<double, 7, 7>::Zero();
  spread.topLeftCorner<6, 6>() = noise;
  spread(6, 6) = scale_variance;
  driver.topLeftCorner<3, 3>() = frame;
  driver.block<3, 3>(0, 3) = skew(arm) * frame;
  driver.block<3, 1>(0, 6) = -arm;
  driver.block<3, 3>(3, 3) = frame;
  driver(6, 6) = 1;
  covariance.block<7, 7>(kMapPosition, kMapPosition) += driver * spread * driver.transpose();
}

void CapsuleBelief::establish_map(const SE3& map_T_camera, const Matrix6d& noise) {
  rig_T_map.rotation = (rig_R_camera * map_T_camera.rotation.conjugate()).normalized();
  const Eigen::Vector3d seen = map_scale * map_T_camera.translation;
  rig_T_map.translation = rig_T_camera().translation - rig_T_map.rotation * seen;
  has_map = true;

  // The map's errors are the pose's, carried over, and the measurement's.
  const Eigen::Matrix3d frame = map_T_camera.rotation.toRotationMatrix();
  const Eigen::Matrix3d map_R_rig = rig_T_map.rotation.conjugate().toRotationMatrix();
  ErrorMatrix carry = ErrorMatrix::Identity();
  carry.middleRows<6>(kMapPosition).setZero();
  carry.block<3, 3>(kMapRotation, kRotation) = frame;
  carry.middleRows<3>(kMapPosition) = map_R_rig * camera_jacobian();
  carry.block<3, 3>(kMapPosition, kRotation) += skew(seen) * frame;
  carry.block<3, 1>(kMapPosition, kMapScale) = -seen;
  covariance = (carry * covariance * carry.transpose()).eval();
  Matrix6d driver = Matrix6d::Zero();
  driver.topLeftCorner<3, 3>() = frame;
  driver.topRightCorner<3, 3>() = skew(seen) * frame;
  driver.bottomRightCorner<3, 3>() = frame;
  covariance.block<6, 6>(kMapPosition, kMapPosition) += driver * noise * driver.transpose();
}

CapsuleBelief CapsuleBelief::rolled(double angle, double variance) const {
  CapsuleBelief turned = *this;
  turned.has_map = false;
  turned.rig_R_camera = (rig_R_camera * so3_exp(angle * magnet_axis)).normalized();
  // Camera-frame errors in the turned frame; what was known of the old roll, and with it of the
  // map, is forgotten.
  const Eigen::Matrix3d frame = so3_exp(-angle * magnet_axis).toRotationMatrix();
  ErrorMatrix forget = ErrorMatrix::Identity();
  forget.block<3, 3>(kRotation, kRotation) = frame - magnet_axis * magnet_axis.transpose();
  forget.middleRows<6>(kMapPosition).setZero();
  turned.covariance = forget * covariance * forget.transpose();
  turned.covariance.block<3, 3>(kRotation, kRotation) +=
      variance * magnet_axis * magnet_axis.transpose();
  return turned;
}

Matrix6d CapsuleBelief::pose_covariance() const {
  Eigen::Matrix<double, 6, kErrorSize> jacobian = Eigen::Matrix<double, 6, kErrorSize>::Zero();
  jacobian.topRows<3>() = camera_jacobian();
  jacobian.block<3, 3>(3, kRotation).setIdentity();
  return jacobian * covariance * jacobian.transpose();
}

Eigen::Matrix<double, 3, kErrorSize> CapsuleBelief::camera_jacobian() const {
  const Eigen::Matrix3d frame = rig_R_camera.toRotationMatrix();
  Eigen::Matrix<double, 3, kErrorSize> jacobian = Eigen::Matrix<double, 3, kErrorSize>::Zero();
  jacobian.middleCols<3>(kPosition).setIdentity();
  jacobian.middleCols<3>(kRotation) = frame * skew(magnet_position);
  jacobian.middleCols<3>(kMagnetPosition) = -frame;
  return jacobian;
}

void CapsuleBelief::add(const ErrorVector& error) {
  position += error.segment<3>(kPosition);
  rig_R_camera = (rig_R_camera * so3_exp(error.segment<3>(kRotation))).normalized();
  velocity += error.segment<3>(kVelocity);
  turn += error.segment<3>(kTurn);
  rig_T_map.translation += rig_T_map.rotation * error.segment<3>(kMapPosition);
  rig_T_map.rotation = (rig_T_map.rotation * so3_exp(error.segment<3>(kMapRotation))).normalized();
  map_scale *= std::exp(error(kMapScale));
  position_bias += error.segment<3>(kPositionBias);
  axis_bias += error.segment<3>(kAxisBias);
  magnet_position += error.segment<3>(kMagnetPosition);
  const Eigen::Quaterniond tilt =
      so3_exp(perpendicular_basis(magnet_axis) * error.segment<2>(kMagnetAxis));
  magnet_axis = (tilt * magnet_axis).normalized();
  // What is unknown about the old axis is unknown about the new one.
  const Eigen::Matrix3d follow = tilt.toRotationMatrix();
  covariance.middleRows<3>(kRotation) = (follow * covariance.middleRows<3>(kRotation)).eval();
  covariance.middleCols<3>(kRotation) =
      (covariance.middleCols<3>(kRotation) * follow.transpose()).eval();
  time_offset += error(kTimeOffset);
}

Matrix6d swinging_noise(double position_std, double rotation_std, double distance) {
  // What stays in place is the point (0, 0, distance): translation = distance z x rotation.
  Matrix63 from_rotation;
  from_rotation << distance * skew(Eigen::Vector3d::UnitZ()), Eigen::Matrix3d::Identity();
  Matrix6d noise = rotation_std * rotation_std * from_rotation * from_rotation.transpose();
  noise.topLeftCorner<3, 3>().diagonal().array() += position_std * position_std;
  return noise;
}

}  // namespace gastronaut::fusion

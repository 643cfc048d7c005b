#include "sensor_fusion/capsule_belief.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <cmath>

#include "numerics/counter_random.hpp"

namespace gastronaut::fusion {
namespace {

constexpr double kStep = 1e-6;        // of numerical differentiation
constexpr double kDerivative = 1e-6;  // central differences: step squared and rounding / step
constexpr double kRounding = 1e-12;
constexpr double kScatter = 0.8;  // of the fix's variance; the rest is bias

struct Noise {
  explicit Noise(std::uint64_t seed) : random(seed, 0) {}
  double operator()() { return random.normal(index++); }
  template <int kSize>
  Eigen::Matrix<double, kSize, 1> vector(double std) {
    Eigen::Matrix<double, kSize, 1> result;
    for (int i = 0; i < kSize; ++i) result(i) = std * (*this)();
    return result;
  }
  CounterRandom random;
  std::uint64_t index = 0;
};

// A covariance that connects everything with everything.
ErrorMatrix some_covariance(double std) {
  Noise noise(5);
  ErrorMatrix root;
  for (int i = 0; i < kErrorSize; ++i) root.col(i) = noise.vector<kErrorSize>(std);
  return root * root.transpose() / kErrorSize;
}

CapsuleBelief some_belief() {
  CapsuleBelief belief;
  belief.position = {0.02, -0.03, 0.06};
  belief.rig_R_camera = so3_exp({0.4, -1.1, 0.7});
  belief.velocity = {0.02, 0.01, -0.03};
  belief.turn = {0.5, -0.3, 0.8};
  belief.rig_T_map = {so3_exp({-0.7, 0.2, 1.3}), {0.05, 0.02, -0.04}};
  belief.map_scale = 1.1;
  belief.has_map = true;
  belief.position_bias = {1e-4, -2e-4, 3e-4};
  belief.axis_bias = {4e-3, -2e-3, 1e-3};
  belief.magnet_position = {1e-3, 2e-3, -8e-3};
  belief.magnet_axis = Eigen::Vector3d(0.2, -0.3, 0.9).normalized();
  belief.time_offset = 0.01;
  belief.covariance = some_covariance(1e-3);
  return belief;
}

MagneticFix expected_fix(const CapsuleBelief& belief) {
  MagneticFix fix;
  fix.position = belief.position + belief.position_bias + belief.velocity * belief.time_offset;
  fix.axis = so3_exp(belief.turn * belief.time_offset + belief.axis_bias) * belief.axis_in_rig();
  return fix;
}

SE3 expected_pose(const CapsuleBelief& belief) {
  SE3 pose = belief.rig_T_map.inverse() * belief.rig_T_camera();
  pose.translation /= belief.map_scale;
  return pose;
}

CapsuleBelief moved(const CapsuleBelief& belief, int index, double by) {
  CapsuleBelief result = belief;
  ErrorVector error = ErrorVector::Zero();
  error(index) = by;
  result.add(error);
  return result;
}

// What add() would have to be given to make `to` of `from`.
ErrorVector difference(const CapsuleBelief& to, const CapsuleBelief& from) {
  ErrorVector error;
  error.segment<3>(kPosition) = to.position - from.position;
  error.segment<3>(kRotation) = so3_log(from.rig_R_camera.conjugate() * to.rig_R_camera);
  error.segment<3>(kVelocity) = to.velocity - from.velocity;
  error.segment<3>(kTurn) = to.turn - from.turn;
  const SE3 map = from.rig_T_map.inverse() * to.rig_T_map;
  error.segment<3>(kMapPosition) = map.translation;
  error.segment<3>(kMapRotation) = so3_log(map.rotation);
  error(kMapScale) = std::log(to.map_scale / from.map_scale);
  error.segment<3>(kPositionBias) = to.position_bias - from.position_bias;
  error.segment<3>(kAxisBias) = to.axis_bias - from.axis_bias;
  error.segment<3>(kMagnetPosition) = to.magnet_position - from.magnet_position;
  error.segment<2>(kMagnetAxis) =
      perpendicular_basis(from.magnet_axis).transpose() *
      so3_log(Eigen::Quaterniond::FromTwoVectors(from.magnet_axis, to.magnet_axis));
  error(kTimeOffset) = to.time_offset - from.time_offset;
  return error;
}

// Central differences of `residual_of(belief)`: residuals fall as errors are added.
template <class ResidualOf>
Eigen::MatrixXd numerical(const CapsuleBelief& belief, const ResidualOf& residual_of) {
  Eigen::MatrixXd jacobian(residual_of(belief).size(), kErrorSize);
  for (int i = 0; i < kErrorSize; ++i) {
    jacobian.col(i) =
        (residual_of(moved(belief, i, -kStep)) - residual_of(moved(belief, i, kStep))) /
        (2 * kStep);
  }
  return jacobian;
}

TEST(CapsuleBelief, JacobianOfTheMagnetIsTheDerivative) {
  const CapsuleBelief belief = some_belief();
  const MagneticFix fix = expected_fix(belief);
  for (const bool with_axis : {false, true}) {
    const auto residual_of = [&](const CapsuleBelief& at) -> Eigen::VectorXd {
      return at.observe_magnet(fix, kScatter, with_axis).residual;
    };
    Eigen::MatrixXd expected = numerical(belief, residual_of);
    // Left out on purpose: the turn times the time offset is of second order, and the time offset
    // must not teach the roll.
    expected.middleCols<3>(kTurn).setZero();
    if (with_axis) expected.col(kTimeOffset).tail<2>().setZero();
    const Innovation innovation = belief.observe_magnet(fix, kScatter, with_axis);
    ASSERT_EQ(innovation.residual.size(), with_axis ? 5 : 3);
    EXPECT_LT(innovation.residual.norm(), kRounding);
    // Rotations by the axis bias are differentiated at a turn of a few milliradians: first order.
    constexpr double kCurvature = 1e-2;
    EXPECT_LT((innovation.jacobian - expected).cwiseAbs().maxCoeff(), kCurvature);
    EXPECT_LT((innovation.jacobian - expected).topRows<3>().cwiseAbs().maxCoeff(), kDerivative);
  }
}

TEST(CapsuleBelief, JacobianOfTheMagnetIsExactWithoutBiasAndOffset) {
  CapsuleBelief belief = some_belief();
  belief.axis_bias.setZero();
  belief.time_offset = 0;
  const MagneticFix fix = expected_fix(belief);
  const auto residual_of = [&](const CapsuleBelief& at) -> Eigen::VectorXd {
    return at.observe_magnet(fix, kScatter, true).residual;
  };
  Eigen::MatrixXd expected = numerical(belief, residual_of);
  expected.col(kTimeOffset).tail<2>().setZero();
  EXPECT_LT((belief.observe_magnet(fix, kScatter, true).jacobian - expected).cwiseAbs().maxCoeff(),
            kDerivative);
}

TEST(CapsuleBelief, JacobianOfTheCameraIsTheDerivative) {
  const CapsuleBelief belief = some_belief();
  const SE3 pose = expected_pose(belief);
  const Matrix6d noise = Matrix6d::Identity();
  const auto residual_of = [&](const CapsuleBelief& at) -> Eigen::VectorXd {
    return at.observe_camera(pose, noise, false).residual;
  };
  const Innovation innovation = belief.observe_camera(pose, noise, false);
  EXPECT_LT(innovation.residual.norm(), kRounding);
  EXPECT_LT((innovation.jacobian - numerical(belief, residual_of)).cwiseAbs().maxCoeff(),
            kDerivative);
  // The paper's: the map's rotation is taken as known.
  const Innovation paper = belief.observe_camera(pose, noise, true);
  Eigen::MatrixXd expected = numerical(belief, residual_of).bottomRows<3>();
  expected.middleCols<3>(kMapRotation).setZero();
  EXPECT_LT((paper.jacobian - expected).cwiseAbs().maxCoeff(), kDerivative);
}

TEST(CapsuleBelief, PredictionFadesVelocities) {
  BeliefModel model;
  CapsuleBelief belief = some_belief();
  const CapsuleBelief before = belief;
  constexpr double kElapsed = 0.7;
  belief.predict(kElapsed, model, Matrix6d::Zero());
  const double keeps = std::exp(-kElapsed / model.velocity_memory);
  EXPECT_LT((belief.velocity - keeps * before.velocity).norm(), kRounding);
  // The integral of the fading velocity.
  const Eigen::Vector3d path = before.velocity * model.velocity_memory * (1 - keeps);
  EXPECT_LT((belief.position - before.position - path).norm(), kRounding);
  const double turned = model.turn_memory * (1 - std::exp(-kElapsed / model.turn_memory));
  EXPECT_LT(angle_between(belief.rig_R_camera, so3_exp(turned * before.turn) * before.rig_R_camera),
            1e-7);  // square root of rounding
}

TEST(CapsuleBelief, PredictedCovarianceIsThePropagatedOne) {
  BeliefModel model;
  model.acceleration_std = model.angular_acceleration_std = 0;
  CapsuleBelief start = some_belief();
  constexpr double kElapsed = 0.05;
  Eigen::Matrix<double, kErrorSize, kErrorSize> transition;
  CapsuleBelief end = start;
  end.predict(kElapsed, model, Matrix6d::Zero());
  for (int i = 0; i < kErrorSize; ++i) {
    CapsuleBelief plus = moved(start, i, kStep);
    CapsuleBelief minus = moved(start, i, -kStep);
    plus.predict(kElapsed, model, Matrix6d::Zero());
    minus.predict(kElapsed, model, Matrix6d::Zero());
    transition.col(i) = (difference(plus, end) - difference(minus, end)) / (2 * kStep);
  }
  // How fast the biases are forgotten depends on the speed: not followed to first order.
  transition.block<6, 3>(kPositionBias, kVelocity).setZero();
  const ErrorMatrix expected = transition * start.covariance * transition.transpose();
  // The turn's left Jacobian over one step is taken as the identity: half the angle turned.
  const double angle = start.turn.norm() * kElapsed;
  EXPECT_LT((end.covariance - expected).norm(), angle * kElapsed * expected.norm());
}

TEST(CapsuleBelief, ProcessNoiseIsThatOfWhiteAcceleration) {
  BeliefModel model;
  model.velocity_memory = model.turn_memory = 1e6;  // constant velocity
  CapsuleBelief belief = some_belief();
  belief.covariance.setZero();
  constexpr double kElapsed = 0.2;
  belief.predict(kElapsed, model, Matrix6d::Zero());
  const double q = model.acceleration_std * model.acceleration_std;
  const double w = model.angular_acceleration_std * model.angular_acceleration_std;
  constexpr double kRelative = 1e-6;  // the memory is not infinite
  for (int i = 0; i < 3; ++i) {
    const auto at = [&](int a, int b) { return belief.covariance(a + i, b + i); };
    EXPECT_NEAR(at(kPosition, kPosition), q * std::pow(kElapsed, 3) / 3, q * kRelative);
    EXPECT_NEAR(at(kPosition, kVelocity), q * std::pow(kElapsed, 2) / 2, q * kRelative);
    EXPECT_NEAR(at(kVelocity, kVelocity), q * kElapsed, q * kRelative);
    EXPECT_NEAR(at(kRotation, kRotation), w * std::pow(kElapsed, 3) / 3, w * kRelative);
    EXPECT_NEAR(at(kTurn, kTurn), w * kElapsed, w * kRelative);
  }
}

TEST(CapsuleBelief, BiasesForgetTowardsTheirLongRunCovariance) {
  BeliefModel model;
  CapsuleBelief belief = some_belief();
  belief.covariance.setZero();
  const Matrix6d long_run = 4e-8 * Matrix6d::Identity();
  const double path = belief.velocity.norm();
  constexpr double kElapsed = 0.5;
  belief.predict(kElapsed, model, long_run);
  const double keeps = std::exp(-kElapsed * (path / model.bias_length + 1 / model.bias_time));
  const Matrix6d expected = (1 - keeps * keeps) * long_run;
  EXPECT_LT((belief.covariance.block<6, 6>(kPositionBias, kPositionBias) - expected).norm(),
            kRounding * long_run.norm());
}

TEST(CapsuleBelief, UpdateIsTheTextbookKalmanUpdate) {
  CapsuleBelief belief = some_belief();
  belief.learns_calibration = true;
  const ErrorMatrix before = belief.covariance;
  MagneticFix fix = expected_fix(belief);
  fix.position += Eigen::Vector3d(2e-4, -1e-4, 3e-4);
  fix.covariance = 1e-6 * Matrix5d::Identity();
  const Innovation innovation = belief.observe_magnet(fix, kScatter, false);
  const Eigen::MatrixXd h = innovation.jacobian;
  const Eigen::MatrixXd noise = kScatter * 1e-6 * Eigen::Matrix3d::Identity();
  const Eigen::MatrixXd sum = h * before * h.transpose() + noise;
  const Eigen::MatrixXd gain = before * h.transpose() * sum.inverse();
  const ErrorVector step = gain * innovation.residual;
  const double chi2 = innovation.residual.dot(sum.inverse() * innovation.residual);
  const Gain weighed = belief.weigh(innovation);
  constexpr double kRelative = 1e-8;
  EXPECT_NEAR(weighed.chi2, chi2, kRelative * chi2);
  const double log_det = std::log((2 * M_PI * sum).determinant());
  EXPECT_NEAR(weighed.log_density, -0.5 * (chi2 + log_det), kRelative * std::abs(log_det));

  const CapsuleBelief start = belief;
  belief.update(weighed);
  EXPECT_LT((difference(belief, start) - step).norm(), 1e-3 * step.norm());  // second order
  ErrorMatrix expected = (ErrorMatrix::Identity() - gain * h) * before;
  // The axis moved by a little: so does what is known about it.
  EXPECT_LT((belief.covariance - expected).norm(), 1e-3 * expected.norm());
}

TEST(CapsuleBelief, CalibrationStaysAsItIsUnlessItIsToBeLearnt) {
  for (const bool learns : {false, true}) {
    CapsuleBelief belief = some_belief();
    belief.learns_calibration = learns;
    const CapsuleBelief before = belief;
    MagneticFix fix = expected_fix(belief);
    fix.position.x() += 1e-3;
    fix.covariance = 1e-8 * Matrix5d::Identity();
    belief.update(belief.weigh(belief.observe_magnet(fix, kScatter, true)));
    const double moved_by = difference(belief, before).tail<kCalibrationSize>().norm();
    const double learnt = (belief.covariance - before.covariance)
                              .bottomRightCorner<kCalibrationSize, kCalibrationSize>()
                              .norm();
    if (learns) {
      EXPECT_GT(moved_by, 0);
      EXPECT_GT(learnt, 0);
    } else {
      EXPECT_EQ(moved_by, 0);
      EXPECT_EQ(learnt, 0);
    }
    const Eigen::LLT<ErrorMatrix> positive(belief.covariance);
    EXPECT_EQ(positive.info(), Eigen::Success);
  }
}

TEST(CapsuleBelief, EstablishedMapPutsTheCameraWhereItIs) {
  CapsuleBelief belief = some_belief();
  const SE3 pose{so3_exp({0.3, 0.9, -0.2}), {0.03, -0.01, 0.05}};
  const Matrix6d noise = swinging_noise(1e-4, 2e-3, 0.04);
  const CapsuleBelief before = belief;
  belief.establish_map(pose, noise);
  EXPECT_LT(belief.observe_camera(pose, noise, false).residual.norm(), kRounding);

  // First order: the map as a function of the belief's errors and the measurement's.
  const auto carried = [&](const CapsuleBelief& from, const Vector6d& error) {
    CapsuleBelief to = from;
    SE3 erring = pose;
    // Errors of the camera frame, metric.
    erring.translation += pose.rotation * error.head<3>() / from.map_scale;
    erring.rotation = pose.rotation * so3_exp(error.tail<3>());
    to.establish_map(erring, noise);
    return difference(to, belief);
  };
  ErrorMatrix transition;
  for (int i = 0; i < kErrorSize; ++i) {
    transition.col(i) = (carried(moved(before, i, kStep), Vector6d::Zero()) -
                         carried(moved(before, i, -kStep), Vector6d::Zero())) /
                        (2 * kStep);
  }
  Eigen::Matrix<double, kErrorSize, 6> driver;
  for (int i = 0; i < 6; ++i) {
    driver.col(i) =
        (carried(before, kStep * Vector6d::Unit(i)) - carried(before, -kStep * Vector6d::Unit(i))) /
        (2 * kStep);
  }
  const ErrorMatrix expected =
      transition * before.covariance * transition.transpose() + driver * noise * driver.transpose();
  EXPECT_LT((belief.covariance - expected).norm(), 1e-5 * expected.norm());
}

TEST(CapsuleBelief, DriftOfTheMapIsSeenAtTheCameraAsGiven) {
  CapsuleBelief belief = some_belief();
  const SE3 pose = expected_pose(belief);
  const Matrix6d noise = swinging_noise(1e-4, 2e-3, 0.04);
  const auto spread = [&] {
    const Eigen::MatrixXd h = belief.observe_camera(pose, noise, false).jacobian;
    return Matrix6d(h * belief.covariance * h.transpose());
  };
  const Matrix6d before = spread();
  const double scale_before = belief.covariance(kMapScale, kMapScale);
  constexpr double kScaleVariance = 1e-4;
  belief.let_map_drift(noise, kScaleVariance);
  // The map grows about the camera: the camera sees nothing of that.
  EXPECT_LT((spread() - before - noise).norm(), 1e-9 * noise.norm());
  EXPECT_NEAR(belief.covariance(kMapScale, kMapScale) - scale_before, kScaleVariance, kRounding);
}

TEST(CapsuleBelief, RolledTurnsAboutTheMagnet) {
  const CapsuleBelief belief = some_belief();
  constexpr double kAngle = 0.8;
  constexpr double kVariance = 0.3;
  const CapsuleBelief turned = belief.rolled(kAngle, kVariance);
  EXPECT_FALSE(turned.has_map);
  EXPECT_LT((turned.axis_in_rig() - belief.axis_in_rig()).norm(), kRounding);
  EXPECT_NEAR(angle_between(turned.rig_R_camera, belief.rig_R_camera), kAngle, 1e-9);
  const Eigen::Vector3d axis = belief.magnet_axis;
  const Eigen::Matrix3d rotation = turned.covariance.block<3, 3>(kRotation, kRotation);
  EXPECT_NEAR(axis.dot(rotation * axis), kVariance, kRounding);
  // What the magnet tells, in the rig, is as well known as before.
  const auto tilt = [](const CapsuleBelief& of) {
    const Eigen::Matrix3d frame = skew(of.axis_in_rig()) * of.rig_R_camera.toRotationMatrix();
    return Eigen::Matrix3d(frame * of.covariance.block<3, 3>(kRotation, kRotation) *
                           frame.transpose());
  };
  EXPECT_LT((tilt(turned) - tilt(belief)).norm(), 1e-9 * tilt(belief).norm());
}

TEST(CapsuleBelief, PoseCovarianceIsThatOfManyDrawnBeliefs) {
  CapsuleBelief belief = some_belief();
  const Eigen::LLT<ErrorMatrix> root(belief.covariance);
  const SE3 centre = belief.rig_T_camera();
  Noise noise(11);
  Matrix6d sum = Matrix6d::Zero();
  constexpr int kDraws = 10'000;
  for (int i = 0; i < kDraws; ++i) {
    CapsuleBelief drawn = belief;
    drawn.add(root.matrixL() * noise.vector<kErrorSize>(1));
    const SE3 pose = drawn.rig_T_camera();
    Vector6d offset;
    offset << pose.translation - centre.translation,
        so3_log(centre.rotation.conjugate() * pose.rotation);
    sum += offset * offset.transpose() / kDraws;
  }
  const Matrix6d expected = belief.pose_covariance();
  // Relative standard error of a covariance from n draws: sqrt(2 / n); 6 of them.
  EXPECT_LT((sum - expected).norm(), 6 * std::sqrt(2.0 / kDraws) * expected.norm());
}

// A roll that only the magnet speaks of stays as open as it was, however the magnet tilts.
TEST(CapsuleBelief, RollIsNeverLearntFromTheMagnetAlone) {
  const BeliefModel model;
  constexpr double kInterval = 0.01;
  constexpr double kPositionStd = 3e-4;
  constexpr double kAxisStd = 5e-3;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    Noise noise(seed);
    CapsuleBelief start;
    start.magnet_position = {0, 0, -8e-3};
    start.covariance.diagonal().setConstant(1e-6);
    start.covariance.diagonal().segment<3>(kTurn).setOnes();
    start.covariance.diagonal().segment<3>(kVelocity).setConstant(2.5e-3);
    start.covariance.diagonal().segment<2>(kMagnetAxis).setConstant(2.5e-5);
    constexpr double kOpen = 0.3;
    CapsuleBelief belief = start.rolled(0.5, kOpen * kOpen);
    MagneticFix fix;
    fix.covariance.diagonal() << Eigen::Vector3d::Constant(kPositionStd * kPositionStd),
        Eigen::Vector2d::Constant(kAxisStd * kAxisStd);
    Matrix6d bias = Matrix6d::Zero();
    bias.diagonal() << 0.2 * fix.covariance.diagonal().head<3>(),
        Eigen::Vector3d::Constant(0.2 * kAxisStd * kAxisStd);
    for (int i = 1; i <= 500; ++i) {
      const double t = i * kInterval;
      const Eigen::Quaterniond truth = so3_exp(
          {0.6 * std::sin(1.3 * t), 0.7 * std::sin(1.9 * t + static_cast<double>(seed)), 0.0});
      fix.position = noise.vector<3>(kPositionStd);
      fix.axis = truth * Eigen::Vector3d::UnitZ();
      fix.axis = so3_exp(perpendicular_basis(fix.axis) * noise.vector<2>(kAxisStd)) * fix.axis;
      belief.predict(kInterval, model, bias);
      belief.update(belief.weigh(belief.observe_magnet(fix, 1 - model.bias_share, true)));
      const Eigen::Matrix3d rotation = belief.covariance.block<3, 3>(kRotation, kRotation);
      const double sigma = std::sqrt(belief.magnet_axis.dot(rotation * belief.magnet_axis));
      // A hundredth for linearisation.
      ASSERT_GT(sigma, 0.99 * kOpen) << "seed " << seed << ", " << t << " s";
    }
  }
}

TEST(CapsuleBelief, SwingingLeavesWhatIsSeenInPlace) {
  constexpr double kDistance = 0.04;
  constexpr double kPositionStd = 2e-4;
  const Matrix6d noise = swinging_noise(kPositionStd, 3e-3, kDistance);
  // A point fixed in the world moves in the camera by -(translation + rotation x point).
  Eigen::Matrix<double, 3, 6> moves;
  moves << Eigen::Matrix3d::Identity(), -skew(kDistance * Eigen::Vector3d::UnitZ());
  const Eigen::Matrix3d spread = moves * noise * moves.transpose();
  const Eigen::Matrix3d expected = kPositionStd * kPositionStd * Eigen::Matrix3d::Identity();
  EXPECT_LT((spread - expected).norm(), 1e-9 * expected.norm());
}

}  // namespace
}  // namespace gastronaut::fusion

#include "geometry/se3.hpp"

#include <gtest/gtest.h>

#include <numbers>

#include "numerics/counter_random.hpp"

namespace gastronaut {
namespace {

constexpr double kRounding = 1e-12;

Vector6d random_twist(std::uint64_t index) {
  const CounterRandom random(7, index);
  Vector6d twist;
  for (int i = 0; i < 6; ++i) twist[i] = 2 * random.uniform(static_cast<std::uint64_t>(i)) - 1;
  return twist;
}

TEST(SE3, LogInvertsExp) {
  for (std::uint64_t i = 0; i < 100; ++i) {
    const Vector6d twist = random_twist(i);
    EXPECT_LT((SE3::exp(twist).log() - twist).norm(), kRounding);
  }
}

TEST(SE3, ExpOfTinyTwistKeepsItsFirstOrder) {
  Vector6d twist;
  twist << 1e-9, -2e-9, 3e-9, 4e-9, 5e-9, -6e-9;
  EXPECT_LT((SE3::exp(twist).log() - twist).norm(), 1e-20);
}

TEST(SE3, LogOfHalfTurnHasLengthPi) {
  const Eigen::Vector3d half_turn(0, std::numbers::pi, 0);
  EXPECT_NEAR(so3_log(so3_exp(half_turn)).norm(), std::numbers::pi, kRounding);
}

TEST(SE3, InverseUndoes) {
  const SE3 a = SE3::exp(random_twist(3));
  EXPECT_LT((a * a.inverse()).log().norm(), kRounding);
  EXPECT_LT(((a * a).matrix() - a.matrix() * a.matrix()).norm(), kRounding);
}

TEST(SE3, AdjointMovesTwistThroughTransform) {
  const SE3 a = SE3::exp(random_twist(4));
  const Vector6d twist = random_twist(5);
  const SE3 left = SE3::exp(a.adjoint() * twist) * a;
  const SE3 right = a * SE3::exp(twist);
  EXPECT_LT((left.matrix() - right.matrix()).norm(), kRounding);
}

TEST(SE3, LeftJacobianMatchesFiniteDifference) {
  const Eigen::Vector3d w = random_twist(6).head<3>();
  constexpr double kStep = 1e-6;
  constexpr double kSecondOrder = 1e-5;
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(i);
    const Eigen::Vector3d measured = so3_log(so3_exp(w + step) * so3_exp(w).conjugate()) / kStep;
    EXPECT_LT((measured - so3_left_jacobian(w).col(i)).norm(), kSecondOrder);
  }
}

TEST(SE3, InterpolationReachesBothEnds) {
  const SE3 a = SE3::exp(random_twist(8));
  const SE3 b = SE3::exp(random_twist(9));
  EXPECT_LT((interpolate(a, b, 0).matrix() - a.matrix()).norm(), kRounding);
  EXPECT_LT((interpolate(a, b, 1).matrix() - b.matrix()).norm(), kRounding);
}

TEST(PerpendicularBasis, CompletesARightHandedFrame) {
  for (std::uint64_t i = 0; i < 50; ++i) {
    const Eigen::Vector3d axis = random_twist(i).head<3>().normalized();
    Eigen::Matrix3d frame;
    frame << perpendicular_basis(axis), axis;
    EXPECT_LT((frame.transpose() * frame - Eigen::Matrix3d::Identity()).norm(), kRounding);
    EXPECT_NEAR(frame.determinant(), 1, kRounding);
  }
  Eigen::Matrix3d down;
  down << perpendicular_basis(-Eigen::Vector3d::UnitZ()), -Eigen::Vector3d::UnitZ();
  EXPECT_NEAR(down.determinant(), 1, kRounding);
}

}  // namespace
}  // namespace gastronaut

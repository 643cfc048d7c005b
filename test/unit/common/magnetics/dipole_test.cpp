#include "magnetics/dipole.hpp"

#include <gtest/gtest.h>

#include <Eigen/Geometry>

namespace gastronaut {
namespace {

constexpr double kRounding = 1e-12;
// Central differences over 10 um of a field that varies over centimetres.
constexpr double kStep = 1e-5;
constexpr double kDifferenceError = 1e-5;

const Eigen::Vector3d kOffset(0.03, -0.05, 0.04);  // metres
const Eigen::Vector3d kMoment(0.2, 0.3, -0.1);     // A m^2

TEST(Dipole, FieldOnTheAxisAndOnTheEquatorIsTheTextbooks) {
  constexpr double kDistance = 0.05;
  constexpr double kStrength = 0.4;
  const double unit = 1e-7 * kStrength / (kDistance * kDistance * kDistance);
  const Eigen::Vector3d moment = kStrength * Eigen::Vector3d::UnitZ();
  EXPECT_LT((dipole_field(kDistance * Eigen::Vector3d::UnitZ(), moment) -
             2 * unit * Eigen::Vector3d::UnitZ())
                .norm(),
            kRounding * unit);
  EXPECT_LT(
      (dipole_field(kDistance * Eigen::Vector3d::UnitX(), moment) + unit * Eigen::Vector3d::UnitZ())
          .norm(),
      kRounding * unit);
}

TEST(Dipole, FieldIsLinearInTheMoment) {
  const Eigen::Vector3d field = dipole_field(kOffset, kMoment);
  EXPECT_LT((dipole_field_by_moment(kOffset) * kMoment - field).norm(), kRounding * field.norm());
}

TEST(Dipole, DerivativeByOffsetIsThatOfTheFieldAndFreeOfCurlAndDivergence) {
  const Eigen::Matrix3d analytic = dipole_field_by_offset(kOffset, kMoment);
  Eigen::Matrix3d numeric;
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d step = kStep * Eigen::Vector3d::Unit(k);
    numeric.col(k) =
        (dipole_field(kOffset + step, kMoment) - dipole_field(kOffset - step, kMoment)) /
        (2 * kStep);
  }
  EXPECT_LT((analytic - numeric).norm(), kDifferenceError * analytic.norm());
  EXPECT_LT(std::abs(analytic.trace()), kRounding * analytic.norm());
  EXPECT_LT((analytic - analytic.transpose()).norm(), kRounding * analytic.norm());
}

}  // namespace
}  // namespace gastronaut

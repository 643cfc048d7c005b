#include "evaluate/consistency.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <limits>
#include <vector>

#include "random_numbers.hpp"

namespace gastronaut::evaluation {
namespace {

TEST(ChiSquareQuantileTest, EqualsPublishedTables) {
  constexpr double kTablePrecision = 0.0006;  // three decimals are printed
  EXPECT_NEAR(chi_square_quantile(0.95, 5), 11.070, kTablePrecision);
  EXPECT_NEAR(chi_square_quantile(0.025, 5), 0.831, kTablePrecision);
  EXPECT_NEAR(chi_square_quantile(0.975, 5), 12.833, kTablePrecision);
  EXPECT_NEAR(chi_square_quantile(0.975, 6), 14.449, kTablePrecision);
  EXPECT_NEAR(chi_square_quantile(0.025, 100), 74.222, kTablePrecision);
  EXPECT_NEAR(chi_square_quantile(0.975, 100), 129.561, kTablePrecision);
}

TEST(ChiSquareQuantileTest, IsNormalForVeryManyDegreesOfFreedom) {
  constexpr double kDegrees = 1e6;
  constexpr double kNormalQuantile = 1.959964;
  // The skewness adds 2/3 (z^2 - 1), here 1.9; what then remains is of order 1 / sqrt(degrees).
  const double expected = kDegrees + kNormalQuantile * std::sqrt(2 * kDegrees) +
                          2.0 / 3 * (kNormalQuantile * kNormalQuantile - 1);
  constexpr double kRemainder = 0.01;
  EXPECT_NEAR(chi_square_quantile(0.975, kDegrees), expected, kRemainder);
}

TEST(ConsistencyTest, ErrorsDrawnFromTheirCovarianceLieInTheBand) {
  constexpr int kSize = 5;
  constexpr int kCount = 4000;
  Draws draws(21);
  Eigen::MatrixXd root(kSize, kSize);
  for (double& entry : root.reshaped()) entry = draws.normal();
  const Eigen::MatrixXd covariance = root * root.transpose();
  std::vector<double> values;
  for (int i = 0; i < kCount; ++i) {
    Eigen::VectorXd unit(kSize);
    for (double& entry : unit) entry = draws.normal();
    const auto value = normalised_error_squared(root * unit, covariance);
    ASSERT_TRUE(value);
    values.push_back(*value);
  }
  const Consistency result = consistency(values, kSize);
  EXPECT_EQ(result.count, values.size());
  EXPECT_GT(result.mean, result.band_low);
  EXPECT_LT(result.mean, result.band_high);
  EXPECT_LT(result.band_low, kSize);
  EXPECT_GT(result.band_high, kSize);
  // Four standard deviations of a share of 0.95 among that many.
  EXPECT_NEAR(result.share_inside, 0.95, 4 * std::sqrt(0.95 * 0.05 / kCount));
}

TEST(ConsistencyTest, DoubtfulCovariancesGiveNoValue) {
  const Eigen::VectorXd error = Eigen::VectorXd::Ones(3);
  EXPECT_FALSE(normalised_error_squared(error, Eigen::MatrixXd::Zero(3, 3)));
  EXPECT_FALSE(normalised_error_squared(error, -Eigen::MatrixXd::Identity(3, 3)));
  Eigen::MatrixXd broken = Eigen::MatrixXd::Identity(3, 3);
  broken(1, 1) = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(normalised_error_squared(error, broken));
  EXPECT_EQ(consistency({}, 5).count, 0U);
}

}  // namespace
}  // namespace gastronaut::evaluation

#include "visual_slam/window_field.hpp"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>

namespace gastronaut::slam {
namespace {

const PinholeGrid kGrid{320, 240, 166.4, 166.4, 159.5, 119.5};
constexpr double kSpacing = 27;
constexpr double kRange = 107;
constexpr double kStd = 0.05;
constexpr double kExact = 1e-9;  // double precision over a few hundred nodes

Eigen::MatrixXd dense(const NodeBand& band) {
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(band.cols(), band.cols());
  for (Eigen::Index k = 0; k < band.cols(); ++k) {
    for (Eigen::Index d = 0; d < std::min(k + 1, band.rows()); ++d) {
      matrix(k, k - d) = matrix(k - d, k) = band(d, k);
    }
  }
  return matrix;
}

class FieldTest : public testing::Test {
 protected:
  const NodeGrid nodes_ = node_grid(kGrid, kSpacing);
  const NodeBand band_ = field_information(nodes_, kStd, kRange);
  const Eigen::MatrixXd matrix_ = dense(band_);
  Eigen::Index node(int i, int j) const { return static_cast<Eigen::Index>(i) * nodes_.rows + j; }
};

TEST_F(FieldTest, NodesCoverThePicture) {
  EXPECT_GE((nodes_.columns - 1) * nodes_.spacing, kGrid.width - 1);
  EXPECT_GE((nodes_.rows - 1) * nodes_.spacing, kGrid.height - 1);
}

TEST_F(FieldTest, PriorHasTheSigmaAndRangeAskedFor) {
  const Eigen::MatrixXd covariance =
      matrix_.llt().solve(Eigen::MatrixXd::Identity(nodes_.size(), nodes_.size()));
  const int i = nodes_.columns / 2;
  const int j = nodes_.rows / 2;
  const double sigma = std::sqrt(covariance(node(i, j), node(i, j)));
  // The formula is that of an endless plane and small spacing.
  constexpr double kEdges = 0.3;
  EXPECT_NEAR(sigma, kStd, kEdges * kStd);
  // A Matern field of smoothness one has z K1(z) at z = kappa times the distance: 0.14 at sqrt 8.
  const int far = static_cast<int>(std::lround(kRange / nodes_.spacing));
  const double correlation = covariance(node(i, j), node(i - far, j)) /
                             std::sqrt(covariance(node(i, j), node(i, j)) *
                                       covariance(node(i - far, j), node(i - far, j)));
  const double z = std::sqrt(8.0) * far * nodes_.spacing / kRange;
  EXPECT_NEAR(correlation, z * std::cyl_bessel_k(1.0, z), kEdges / 2);
}

TEST_F(FieldTest, BandCholeskySolvesAsADenseOne) {
  NodeCholesky cholesky;
  cholesky.compute(band_);
  const Eigen::MatrixXd right = matrix_.leftCols(5) + Eigen::MatrixXd::Ones(nodes_.size(), 5);
  const Eigen::LLT<Eigen::MatrixXd> reference(matrix_);
  const Eigen::MatrixXd half = reference.matrixL().solve(right);
  EXPECT_LT((cholesky.half_solve(right) - half).norm(), kExact * half.norm());
  const Eigen::MatrixXd solution = reference.solve(right);
  EXPECT_LT((cholesky.solve(right) - solution).norm(), kExact * solution.norm());
}

TEST_F(FieldTest, ProductWithABandIsThatWithTheMatrix) {
  const Eigen::VectorXd field = Eigen::VectorXd::LinSpaced(nodes_.size(), -1, 2);
  EXPECT_LT((multiply(band_, field) - matrix_ * field).norm(), kExact * (matrix_ * field).norm());
}

TEST_F(FieldTest, IsLinearBetweenNodes) {
  Eigen::VectorXd field(nodes_.size());
  const auto slope = [](double u, double v) { return 0.1 + 1e-4 * u - 2e-4 * v; };
  for (int i = 0; i < nodes_.columns; ++i) {
    for (int j = 0; j < nodes_.rows; ++j) {
      field(node(i, j)) = slope(i * nodes_.spacing, j * nodes_.spacing);
    }
  }
  Plane<float> depth(kGrid.width, kGrid.height, 1.0F);
  multiply(nodes_, field, depth);
  for (const auto& [u, v] : {std::pair{0, 0}, {319, 239}, {100, 50}, {27, 54}, {13, 200}}) {
    EXPECT_NEAR(value_at(node_weights(nodes_, u, v), field), slope(u, v), kExact);
    // Between nodes exp is replaced by its chord, over steps of the field below 0.01.
    constexpr double kChord = 0.01 * 0.01;
    EXPECT_NEAR(static_cast<double>(depth.at(u, v)), std::exp(slope(u, v)), kChord);
  }
}

}  // namespace
}  // namespace gastronaut::slam

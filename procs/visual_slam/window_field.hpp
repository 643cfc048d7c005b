// A smooth field over a picture: values at nodes of a coarse grid, bilinear between them. As a
// random field it is a Gaussian Markov one, so that its normal matrix is a band.
#pragma once

#include <Eigen/Core>
#include <array>

#include "camera/pinhole_grid.hpp"
#include "image/plane.hpp"

namespace gastronaut::slam {

// Node (i, j), number i * rows + j, is at pixel (i, j) * spacing.
struct NodeGrid {
  int spacing = 1;
  int columns = 0;
  int rows = 0;

  Eigen::Index size() const { return static_cast<Eigen::Index>(columns) * rows; }
};

NodeGrid node_grid(const PinholeGrid& grid, double spacing);

struct NodeWeights {
  std::array<Eigen::Index, 4> node;  // ascending
  std::array<double, 4> weight;
};
NodeWeights node_weights(const NodeGrid& nodes, int u, int v);
double value_at(const NodeWeights& at, const Eigen::VectorXd& field);

// Lower half of a symmetric matrix between nodes no further apart than the field's prior reaches:
// element (k, k - d) is at (d, k).
using NodeBand = Eigen::MatrixXd;

// Information of a Matern field of smoothness one, one sigma `std`, whose correlation has fallen to
// 0.14 at `range` (pixels), after Lindgren, Rue and Lindstrom, "An explicit link between Gaussian
// fields and Gaussian Markov random fields", 2011: (kappa^2 - Laplacian)^2 / scale.
NodeBand field_information(const NodeGrid& nodes, double std, double range);
Eigen::VectorXd multiply(const NodeBand& matrix, const Eigen::VectorXd& field);

// matrix = L L^T, for positive definite bands.
class NodeCholesky {
 public:
  void compute(NodeBand matrix);
  // L^-1 right, column by column.
  Eigen::MatrixXd half_solve(Eigen::MatrixXd right) const;
  // matrix^-1 right.
  Eigen::MatrixXd solve(Eigen::MatrixXd right) const;

 private:
  NodeBand factor_;  // with the inverse of L's diagonal
};

// depth *= exp(field); the factor is what is bilinear between nodes.
void multiply(const NodeGrid& nodes, const Eigen::VectorXd& field, Plane<float>& depth);

}  // namespace gastronaut::slam

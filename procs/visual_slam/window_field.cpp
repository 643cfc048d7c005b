#include "visual_slam/window_field.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "numerics/parallel.hpp"

namespace gastronaut::slam {
namespace {

constexpr std::size_t kRowsAtOnce = 16;

}  // namespace

NodeGrid node_grid(const PinholeGrid& grid, double spacing) {
  NodeGrid nodes;
  nodes.spacing = std::max(1, static_cast<int>(std::lround(spacing)));
  nodes.columns = (grid.width - 1) / nodes.spacing + 2;
  nodes.rows = (grid.height - 1) / nodes.spacing + 2;
  return nodes;
}

NodeWeights node_weights(const NodeGrid& nodes, int u, int v) {
  const Eigen::Index first =
      static_cast<Eigen::Index>(u / nodes.spacing) * nodes.rows + v / nodes.spacing;
  const double right = static_cast<double>(u % nodes.spacing) / nodes.spacing;
  const double down = static_cast<double>(v % nodes.spacing) / nodes.spacing;
  return {{first, first + 1, first + nodes.rows, first + nodes.rows + 1},
          {(1 - right) * (1 - down), (1 - right) * down, right * (1 - down), right * down}};
}

double value_at(const NodeWeights& at, const Eigen::VectorXd& field) {
  double value = 0;
  for (std::size_t k = 0; k < at.node.size(); ++k) value += at.weight[k] * field(at.node[k]);
  return value;
}

NodeBand field_information(const NodeGrid& nodes, double std, double range) {
  const double kappa = std::sqrt(8.0) * nodes.spacing / range;
  const double scale = 4 * M_PI * kappa * kappa * std * std;
  NodeBand band = NodeBand::Zero(2 * nodes.rows + 1, nodes.size());
  // Each node's kappa^2 - Laplacian, a row of a sparse matrix; the band is the product of that
  // matrix with itself.
  for (int i = 0; i < nodes.columns; ++i) {
    for (int j = 0; j < nodes.rows; ++j) {
      const Eigen::Index middle = static_cast<Eigen::Index>(i) * nodes.rows + j;
      std::array<Eigen::Index, 5> node = {middle, middle, middle, middle, middle};
      std::array<double, 5> value = {kappa * kappa, 0, 0, 0, 0};
      const auto couple = [&](std::size_t k, bool inside, Eigen::Index other) {
        if (!inside) return;
        node[k] = other;
        value[k] = -1;
        value[0] += 1;
      };
      couple(1, i > 0, middle - nodes.rows);
      couple(2, i + 1 < nodes.columns, middle + nodes.rows);
      couple(3, j > 0, middle - 1);
      couple(4, j + 1 < nodes.rows, middle + 1);
      for (std::size_t a = 0; a < node.size(); ++a) {
        for (std::size_t b = 0; b < node.size(); ++b) {
          if (node[a] >= node[b]) band(node[a] - node[b], node[a]) += value[a] * value[b] / scale;
        }
      }
    }
  }
  return band;
}

Eigen::VectorXd multiply(const NodeBand& matrix, const Eigen::VectorXd& field) {
  Eigen::VectorXd result = Eigen::VectorXd::Zero(field.size());
  for (Eigen::Index k = 0; k < field.size(); ++k) {
    result(k) += matrix(0, k) * field(k);
    for (Eigen::Index d = 1; d < std::min(k + 1, matrix.rows()); ++d) {
      result(k) += matrix(d, k) * field(k - d);
      result(k - d) += matrix(d, k) * field(k);
    }
  }
  return result;
}

void NodeCholesky::compute(NodeBand matrix) {
  factor_ = std::move(matrix);
  const Eigen::Index width = factor_.rows();
  for (Eigen::Index k = 0; k < factor_.cols(); ++k) {
    // Row k of L, from its leftmost element on.
    for (Eigen::Index d = std::min(k, width - 1); d > 0; --d) {
      double value = factor_(d, k);
      const Eigen::Index shared = std::min(width - 1 - d, k - d);
      for (Eigen::Index e = 1; e <= shared; ++e) value -= factor_(d + e, k) * factor_(e, k - d);
      factor_(d, k) = value * factor_(0, k - d);
    }
    double square = factor_(0, k);
    for (Eigen::Index d = 1; d < std::min(k + 1, width); ++d) {
      square -= factor_(d, k) * factor_(d, k);
    }
    factor_(0, k) = 1 / std::sqrt(square);
  }
}

Eigen::MatrixXd NodeCholesky::half_solve(Eigen::MatrixXd right) const {
  // Worked on sideways, so that what belongs to one node lies together.
  Eigen::MatrixXd rows = right.transpose();
  for (Eigen::Index k = 0; k < factor_.cols(); ++k) {
    for (Eigen::Index d = std::min(k, factor_.rows() - 1); d > 0; --d) {
      rows.col(k) -= factor_(d, k) * rows.col(k - d);
    }
    rows.col(k) *= factor_(0, k);
  }
  return rows.transpose();
}

Eigen::MatrixXd NodeCholesky::solve(Eigen::MatrixXd right) const {
  Eigen::MatrixXd rows = half_solve(std::move(right)).transpose();
  for (Eigen::Index k = factor_.cols() - 1; k >= 0; --k) {
    rows.col(k) *= factor_(0, k);
    for (Eigen::Index d = 1; d < std::min(k + 1, factor_.rows()); ++d) {
      rows.col(k - d) -= factor_(d, k) * rows.col(k);
    }
  }
  return rows.transpose();
}

void multiply(const NodeGrid& nodes, const Eigen::VectorXd& field, Plane<float>& depth) {
  const Eigen::VectorXd factor = field.array().exp();
  parallel_for_chunks(
      static_cast<std::size_t>(depth.height), kRowsAtOnce, [&](std::size_t begin, std::size_t end) {
        std::vector<float> left(static_cast<std::size_t>(nodes.columns));
        for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
          const Eigen::Index above = v / nodes.spacing;
          const double down = static_cast<double>(v % nodes.spacing) / nodes.spacing;
          for (int i = 0; i < nodes.columns; ++i) {
            const Eigen::Index node = static_cast<Eigen::Index>(i) * nodes.rows + above;
            left[static_cast<std::size_t>(i)] =
                static_cast<float>((1 - down) * factor(node) + down * factor(node + 1));
          }
          float* row = depth.row(v);
          for (int u = 0; u < depth.width; ++u) {
            const auto i = static_cast<std::size_t>(u / nodes.spacing);
            const float right =
                static_cast<float>(u % nodes.spacing) / static_cast<float>(nodes.spacing);
            row[u] *= left[i] + right * (left[i + 1] - left[i]);
          }
        }
      });
}

}  // namespace gastronaut::slam

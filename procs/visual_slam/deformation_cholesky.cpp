#include "visual_slam/deformation_cholesky.hpp"

#include <Eigen/Cholesky>
#include <Eigen/OrderingMethods>
#include <Eigen/SparseCore>
#include <algorithm>
#include <iterator>

#include "visual_slam/deformation_kernels.hpp"

namespace gastronaut::slam {

void BlockCholesky::set_pattern(std::size_t nodes, const BlockPattern& pattern) {
  if (symbolic_factorisations_ > 0 && place_of_.size() == nodes && pattern_ == pattern) return;
  ++symbolic_factorisations_;
  pattern_ = pattern;

  const auto size = static_cast<Eigen::Index>(nodes);
  std::vector<Eigen::Triplet<double, int>> entries;
  for (const auto& [row, column] : pattern) {
    entries.emplace_back(row, column, 1.0);
    entries.emplace_back(column, row, 1.0);
  }
  Eigen::SparseMatrix<double, Eigen::ColMajor, int> ones(size, size);
  ones.setFromTriplets(entries.begin(), entries.end());
  Eigen::PermutationMatrix<Eigen::Dynamic, Eigen::Dynamic, int> node_at;
  Eigen::AMDOrdering<int>()(ones, node_at);
  place_of_.resize(nodes);
  for (std::size_t place = 0; place < nodes; ++place) {
    const int node = node_at.indices()[static_cast<Eigen::Index>(place)];
    place_of_[static_cast<std::size_t>(node)] = place;
  }

  // A column of the factor has the matrix's rows and those of the columns whose first row it is.
  std::vector<std::vector<std::size_t>> below(nodes);
  const auto placed = [this](const std::pair<std::int32_t, std::int32_t>& block) {
    return std::minmax(place_of_[static_cast<std::size_t>(block.first)],
                       place_of_[static_cast<std::size_t>(block.second)]);
  };
  for (const auto& block : pattern) {
    const std::pair<std::size_t, std::size_t> at = placed(block);
    if (at.first != at.second) below[at.first].push_back(at.second);
  }
  starts_.assign(1, 0);
  rows_.clear();
  for (std::size_t column = 0; column < nodes; ++column) {
    std::vector<std::size_t>& rows = below[column];
    std::sort(rows.begin(), rows.end());
    rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
    if (!rows.empty()) {
      std::vector<std::size_t>& parent = below[rows.front()];
      parent.insert(parent.end(), rows.begin() + 1, rows.end());
    }
    rows_.push_back(column);
    rows_.insert(rows_.end(), rows.begin(), rows.end());
    starts_.push_back(rows_.size());
  }
  targets_.clear();
  for (const auto& block : pattern) {
    const std::pair<std::size_t, std::size_t> at = placed(block);
    const auto first = rows_.begin() + static_cast<std::ptrdiff_t>(diagonal(at.first));
    const auto last = rows_.begin() + static_cast<std::ptrdiff_t>(end(at.first));
    const auto found = std::lower_bound(first, last, at.second);
    targets_.push_back({static_cast<std::size_t>(std::distance(rows_.begin(), found)),
                        place_of_[static_cast<std::size_t>(block.first)] < at.second});
  }
  factor_.resize(rows_.size());
  inverses_.resize(nodes);
}

bool BlockCholesky::factorise(const std::vector<NodeBlock>& blocks, double damping) {
  std::fill(factor_.begin(), factor_.end(), NodeBlock::Zero());
  for (std::size_t k = 0; k < blocks.size(); ++k) {
    NodeBlock& target = factor_[targets_[k].block];
    if (targets_[k].is_transposed) {
      target = blocks[k].transpose();
    } else {
      target = blocks[k];
    }
  }
  for (std::size_t column = 0; column < inverses_.size(); ++column) {
    NodeBlock& pivot = factor_[diagonal(column)];
    pivot.diagonal().array() += damping;
    const Eigen::LLT<NodeBlock> llt(pivot);
    if (llt.info() != Eigen::Success || !pivot.allFinite()) return false;
    inverses_[column] = llt.matrixL().solve(NodeBlock::Identity());
    for (std::size_t at = diagonal(column) + 1; at < end(column); ++at) {
      const NodeBlock minus = -factor_[at];
      factor_[at].setZero();
      subtract_product(minus.data(), inverses_[column].data(), factor_[at].data());
    }
    // What is left of the columns that this one ties together.
    for (std::size_t b = diagonal(column) + 1; b < end(column); ++b) {
      std::size_t target = diagonal(rows_[b]);
      for (std::size_t a = b; a < end(column); ++a) {
        while (rows_[target] < rows_[a]) ++target;
        subtract_product(factor_[a].data(), factor_[b].data(), factor_[target].data());
      }
    }
  }
  return true;
}

Eigen::VectorXd BlockCholesky::solve(const Eigen::VectorXd& right) const {
  const std::size_t nodes = inverses_.size();
  Eigen::VectorXd x(right.size());
  const auto part = [](auto& vector, std::size_t node) {
    return vector.template segment<kNodeUnknowns>(static_cast<Eigen::Index>(node) * kNodeUnknowns);
  };
  for (std::size_t node = 0; node < nodes; ++node) part(x, place_of_[node]) = part(right, node);
  for (std::size_t column = 0; column < nodes; ++column) {
    part(x, column) = (inverses_[column] * part(x, column)).eval();
    for (std::size_t at = diagonal(column) + 1; at < end(column); ++at) {
      part(x, rows_[at]) -= factor_[at] * part(x, column);
    }
  }
  for (std::size_t column = nodes; column-- > 0;) {
    for (std::size_t at = diagonal(column) + 1; at < end(column); ++at) {
      part(x, column) -= factor_[at].transpose() * part(x, rows_[at]);
    }
    part(x, column) = (inverses_[column].transpose() * part(x, column)).eval();
  }
  Eigen::VectorXd result(right.size());
  for (std::size_t node = 0; node < nodes; ++node) part(result, node) = part(x, place_of_[node]);
  return result;
}

}  // namespace gastronaut::slam

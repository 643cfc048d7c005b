// Sparse Cholesky for equations in which every unknown is a node's twelve numbers.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

namespace gastronaut::slam {

inline constexpr int kNodeUnknowns = 12;
using NodeBlock = Eigen::Matrix<double, kNodeUnknowns, kNodeUnknowns>;
// (row, column) of the blocks that are there, row >= column, ascending, all of the diagonal.
using BlockPattern = std::vector<std::pair<std::int32_t, std::int32_t>>;

// Supernodal in that it works on whole blocks. The order of elimination (approximate minimum
// degree) and the factor's pattern are worked out once and kept while the pattern stays. The same
// bytes on every machine.
class BlockCholesky {
 public:
  void set_pattern(std::size_t nodes, const BlockPattern& pattern);
  // Of the symmetric matrix with these blocks in the pattern's order, and `damping` added to its
  // diagonal. False: it is not positive definite.
  bool factorise(const std::vector<NodeBlock>& blocks, double damping);
  Eigen::VectorXd solve(const Eigen::VectorXd& right) const;

  int symbolic_factorisations() const { return symbolic_factorisations_; }

 private:
  struct Target {
    std::size_t block;  // of the factor
    bool is_transposed;
  };

  // The factor's blocks lie column by column, the diagonal one first.
  std::size_t diagonal(std::size_t column) const { return starts_[column]; }
  std::size_t end(std::size_t column) const { return starts_[column + 1]; }

  BlockPattern pattern_;
  int symbolic_factorisations_ = 0;
  std::vector<std::size_t> place_of_;  // by node: its column
  std::vector<std::size_t> starts_;    // by column: its first block
  std::vector<std::size_t> rows_;      // by block
  std::vector<Target> targets_;        // by block of the matrix
  std::vector<NodeBlock> factor_;
  std::vector<NodeBlock> inverses_;  // of the diagonal's factors
};

}  // namespace gastronaut::slam

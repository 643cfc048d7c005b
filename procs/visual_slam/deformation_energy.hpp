// The energy of deformation_solver.hpp as sums of squares, with its derivatives.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "visual_slam/deformation_cholesky.hpp"
#include "visual_slam/deformation_graph.hpp"
#include "visual_slam/deformation_solver.hpp"

namespace gastronaut::slam {

// Unknowns: node n's twelve from 12 n on are the rows of its [R | t / spacing].
class DeformationEnergy {
 public:
  DeformationEnergy(const DeformationGraph& graph, const DeformationProblem& problem,
                    const DeformationSolverOptions& options);

  DeformationEnergyTerms value(const Eigen::VectorXd& x) const;
  // Of half the energy: its gradient, and Gauss and Newton's matrix in blocks after pattern().
  void equations(const Eigen::VectorXd& x, Eigen::VectorXd& gradient,
                 std::vector<NodeBlock>& blocks) const;
  const BlockPattern& pattern() const { return pattern_; }

  // Metres by which the constraints, respectively pins, are missed in the directions that count.
  double mean_constraint_error(const Eigen::VectorXd& x) const;
  double largest_pin_error(const Eigen::VectorXd& x) const;

 private:
  // A residual linear in the unknowns: sum_i A_i u_i + constant with A_i = [R | t / spacing] of
  // node i; all lengths in spacings.
  enum class Kind : std::uint8_t { kRegularisation, kConstraint, kPin };
  struct Term {
    Kind kind;
    std::size_t count = 0;
    std::array<std::size_t, 2 * kDeformationNeighbours> node{};
    std::array<Eigen::Vector4d, 2 * kDeformationNeighbours> u{};
    Eigen::Vector3d constant = Eigen::Vector3d::Zero();
    Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
    double largest_information = 0;        // in any direction
    std::vector<std::size_t> blocks = {};  // of pairs (i, j <= i)

    void add(std::size_t at, const Eigen::Vector4d& factor);
  };

  void add_regularisation(const DeformationGraph& graph, double weight);
  void add_constraint(const DeformationGraph& graph, const DeformationConstraint& constraint,
                      Kind kind);
  void make_pattern();
  Eigen::Vector3d residual(const Term& term, const Eigen::VectorXd& x) const;
  double error(const Term& term, const Eigen::VectorXd& x) const;

  std::size_t nodes_;
  double spacing_;
  double rotation_;
  double robust2_;
  std::vector<Term> terms_;
  BlockPattern pattern_;
  std::vector<std::size_t> diagonal_;  // by node: its block
};

}  // namespace gastronaut::slam

// Bends a deformation graph so that points of the surface come to lie where they should.
//
// Minimised over the motions (R_n, t_n) of all nodes:
//   w_rot sum_n |R_n^T R_n - 1|^2                                  nodes turn, hardly stretch
//   + w_reg sum_n,m |R_n (g_m - g_n) + g_n + t_n - g_m - t_m|^2 / spacing^2   neighbours agree
//   + sum_c r_c^T Information_c r_c                                constraints and pins
// with r_c = moved(source) - destination. Lengths are counted in the graph's spacing, so that the
// weights mean the same in a stomach and in a room; a constraint of one sigma = spacing / 10 weighs
// ElasticFusion's 100. Gauss-Newton with Levenberg's damping and sparse Cholesky.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "visual_slam/deformation_cholesky.hpp"
#include "visual_slam/deformation_graph.hpp"

namespace gastronaut::slam {

struct DeformationConstraint {
  Eigen::Vector3d source = Eigen::Vector3d::Zero();  // metres, map frame, undeformed; what moves
  TimeSpan source_seen;                              // which layer of the surface it is on
  Eigen::Vector3d destination = Eigen::Vector3d::Zero();  // where it should come to lie,
  std::optional<TimeSpan> destination_seen;  // fixed; or, with this, on that layer, which moves too
  // 1 / m^2, symmetric, not negative: 1 / sigma^2 of the distance in all directions, the inverse of
  // a covariance, or n n^T / sigma^2 where only the distance along a unit vector n counts.
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
};

struct DeformationProblem {
  std::vector<DeformationConstraint> constraints;
  // What has to stay where it is, or has a known place: the part of the surface that a loop closes
  // on (source and destination one), a camera of which the magnet tells the position.
  std::vector<DeformationConstraint> pins;
};

struct DeformationSolverOptions {
  double rotation = 1;         // w_rot, the paper's
  double regularisation = 10;  // w_reg
  double robust_sigmas = 0;    // constraints farther off count less and less (Cauchy); 0: all alike
  int iterations = 20;         // more is no convergence
  double tolerance = 1e-4;     // a change this small ends it: of R, of t in spacings,
  double least_gain = 1e-4;    // or of the energy, as a fraction of it
  int least_constraints = 6;
  double least_spread = 0.5;     // spacings: one sigma of the sources across their main direction
  double least_stretch = 0.5;    // of a node's surroundings, and of the distance of neighbours:
  double largest_stretch = 2.0;  // beyond these limits the surface is torn or folded
};

struct DeformationEnergyTerms {
  double rotation = 0;
  double regularisation = 0;
  double constraints = 0;
  double pins = 0;
  double total() const { return rotation + regularisation + constraints + pins; }
};

struct DeformationReport {
  std::string refusal;  // why the graph was left as it was, in words; empty: it was bent
  int iterations = 0;
  DeformationEnergyTerms before;
  DeformationEnergyTerms after;
  double mean_error_before = 0;  // metres over the constraints, in the directions that count
  double mean_error_after = 0;
  double largest_pin_error = 0;  // metres, after

  bool is_accepted() const { return refusal.empty(); }
};

class DeformationSolver {
 public:
  explicit DeformationSolver(const DeformationSolverOptions& options) : options_(options) {}

  // From the motions that the graph has now. Refused, with the graph left alone: without nodes,
  // with too few constraints or all on a line, with what is not a number, without convergence, and
  // where the result would tear or fold the surface.
  DeformationReport solve(const DeformationProblem& problem, DeformationGraph& graph);

  // How often the sparse factor's pattern was worked out: once for all solutions of one graph whose
  // constraints tie the same nodes.
  int symbolic_factorisations() const { return cholesky_.symbolic_factorisations(); }

 private:
  DeformationSolverOptions options_;
  BlockCholesky cholesky_;
};

}  // namespace gastronaut::slam

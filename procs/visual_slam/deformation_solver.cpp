#include "visual_slam/deformation_solver.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <utility>

#include "visual_slam/deformation_energy.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kMillimetre = 1e-3;
// Of the equations' diagonal, whose entries are about 1: enough to solve where nothing holds a
// node, and too little to slow the rest down.
constexpr double kLeastDamping = 1e-9;
constexpr double kLargestDamping = 1e6;
constexpr double kRounding = 1e-9;  // of an information matrix's largest eigenvalue

template <class... Values>
std::string text(const char* format, Values... values) {
  char buffer[200];
  std::snprintf(buffer, sizeof buffer, format, values...);
  return buffer;
}

Eigen::VectorXd unknowns_of(const DeformationGraph& graph) {
  Eigen::VectorXd x(std::ssize(graph.nodes()) * kNodeUnknowns);
  double* to = x.data();
  for (const DeformationNode& node : graph.nodes()) {
    Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> rows(to);
    rows << node.affine, node.translation / graph.spacing();
    to += kNodeUnknowns;
  }
  return x;
}

void set_unknowns(const Eigen::VectorXd& x, DeformationGraph& graph) {
  for (std::size_t n = 0; n < graph.nodes().size(); ++n) {
    const Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>> rows(x.data() +
                                                                              n * kNodeUnknowns);
    graph.set_motion(n, rows.leftCols<3>(), graph.spacing() * rows.col(3));
  }
}

bool is_sound(const DeformationConstraint& c) {
  if (!c.source.allFinite() || !c.destination.allFinite() || !c.information.allFinite()) {
    return false;
  }
  const Eigen::Vector3d eigenvalues =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(c.information, Eigen::EigenvaluesOnly)
          .eigenvalues();
  return eigenvalues[0] >= -kRounding * eigenvalues[2] && eigenvalues[2] >= 0;
}

std::string why_not_to_try(const DeformationProblem& problem, const DeformationGraph& graph,
                           const DeformationSolverOptions& options) {
  if (graph.nodes().empty()) return "the graph has no nodes";
  const auto& constraints = problem.constraints;
  if (std::ssize(constraints) < options.least_constraints) {
    return text("%td constraints, fewer than %d", std::ssize(constraints),
                options.least_constraints);
  }
  if (!std::all_of(constraints.begin(), constraints.end(), is_sound) ||
      !std::all_of(problem.pins.begin(), problem.pins.end(), is_sound)) {
    return "a constraint or pin is not a number, or its information is negative";
  }
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& each : constraints) mean += each.source;
  mean /= static_cast<double>(constraints.size());
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const auto& each : constraints) {
    scatter += (each.source - mean) * (each.source - mean).transpose();
  }
  scatter /= static_cast<double>(constraints.size());
  const Eigen::Vector3d spread =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(scatter, Eigen::EigenvaluesOnly)
          .eigenvalues()
          .cwiseMax(0)
          .cwiseSqrt();
  if (!(spread[1] >= options.least_spread * graph.spacing())) {
    return text("the constraints lie on a line or a point: %.2f mm along it, %.2f mm across",
                spread[2] / kMillimetre, spread[1] / kMillimetre);
  }
  return {};
}

std::string why_not_to_keep(const Eigen::VectorXd& x, const DeformationGraph& before,
                            const DeformationSolverOptions& options) {
  if (!x.allFinite()) return "the result is not a number";
  DeformationGraph graph = before;
  set_unknowns(x, graph);
  for (const DeformationNode& node : graph.nodes()) {
    const Eigen::Vector3d stretch = Eigen::JacobiSVD<Eigen::Matrix3d>(node.affine).singularValues();
    if (node.affine.determinant() <= 0 || stretch[2] < options.least_stretch ||
        stretch[0] > options.largest_stretch) {
      return text(
          "the surface would fold or tear: at (%.1f, %.1f, %.1f) mm it is stretched by "
          "%.2f to %.2f%s",
          node.position.x() / kMillimetre, node.position.y() / kMillimetre,
          node.position.z() / kMillimetre, stretch[2], stretch[0],
          node.affine.determinant() <= 0 ? " and turned inside out" : "");
    }
  }
  for (const auto& [n, m] : graph.edges()) {
    const DeformationNode& a = graph.nodes()[static_cast<std::size_t>(n)];
    const DeformationNode& b = graph.nodes()[static_cast<std::size_t>(m)];
    const Eigen::Vector3d apart = b.position - a.position;
    const double stretch = (apart + b.translation - a.translation).norm() / apart.norm();
    if (stretch < options.least_stretch || stretch > options.largest_stretch) {
      return text(
          "the surface would fold or tear: from (%.1f, %.1f, %.1f) mm to a neighbour "
          "%.1f mm off it is stretched by %.2f",
          a.position.x() / kMillimetre, a.position.y() / kMillimetre, a.position.z() / kMillimetre,
          apart.norm() / kMillimetre, stretch);
    }
  }
  return {};
}

}  // namespace

DeformationReport DeformationSolver::solve(const DeformationProblem& problem,
                                           DeformationGraph& graph) {
  DeformationReport report;
  report.refusal = why_not_to_try(problem, graph, options_);
  if (!report.is_accepted()) return report;

  const DeformationEnergy energy(graph, problem, options_);
  cholesky_.set_pattern(graph.nodes().size(), energy.pattern());
  Eigen::VectorXd x = unknowns_of(graph);
  report.before = energy.value(x);
  report.after = report.before;
  report.mean_error_before = energy.mean_constraint_error(x);

  Eigen::VectorXd gradient;
  std::vector<NodeBlock> blocks;
  double damping = kLeastDamping;
  bool is_done = false;
  while (!is_done && report.iterations < options_.iterations) {
    ++report.iterations;
    energy.equations(x, gradient, blocks);
    for (bool is_better = false; !is_better && !is_done;) {
      if (cholesky_.factorise(blocks, damping)) {
        const Eigen::VectorXd step = cholesky_.solve(gradient);
        const DeformationEnergyTerms next = energy.value(x - step);
        const double gain = 1 - next.total() / report.after.total();
        is_better = gain > 0;
        // A damped step may gain little for being short.
        is_done = step.lpNorm<Eigen::Infinity>() <= options_.tolerance ||
                  (is_better && gain <= options_.least_gain && damping <= kLeastDamping);
        if (is_better) {
          x -= step;
          report.after = next;
        }
      }
      damping = is_better ? std::max(damping / 10, kLeastDamping) : damping * 10;
      if (damping > kLargestDamping) {
        report.refusal = "the equations cannot be solved";
        return report;
      }
    }
  }
  report.mean_error_after = energy.mean_constraint_error(x);
  report.largest_pin_error = energy.largest_pin_error(x);
  if (!is_done) {
    report.refusal = text("no convergence in %d iterations", report.iterations);
  } else {
    report.refusal = why_not_to_keep(x, graph, options_);
  }
  if (report.is_accepted()) set_unknowns(x, graph);
  return report;
}

}  // namespace gastronaut::slam

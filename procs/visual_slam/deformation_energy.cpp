#include "visual_slam/deformation_energy.hpp"

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>

namespace gastronaut::slam {
namespace {

using Rows = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;  // a node's unknowns

Eigen::Map<const Rows> rows_of(const Eigen::VectorXd& x, std::size_t node) {
  return Eigen::Map<const Rows>(x.data() + node * kNodeUnknowns);
}

// block += information (x) u v^T
void add_product(const Eigen::Matrix3d& information, const Eigen::Vector4d& u,
                 const Eigen::Vector4d& v, NodeBlock& block) {
  const Eigen::Matrix4d product = u * v.transpose();
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      if (information(i, j) == 0) continue;
      block.block<4, 4>(4 * i, 4 * j) += information(i, j) * product;
    }
  }
}

}  // namespace

void DeformationEnergy::Term::add(std::size_t at, const Eigen::Vector4d& factor) {
  for (std::size_t i = 0; i < count; ++i) {
    if (node[i] == at) {
      u[i] += factor;
      return;
    }
  }
  node[count] = at;
  u[count++] = factor;
}

DeformationEnergy::DeformationEnergy(const DeformationGraph& graph,
                                     const DeformationProblem& problem,
                                     const DeformationSolverOptions& options)
    : nodes_(graph.nodes().size()),
      spacing_(graph.spacing()),
      rotation_(options.rotation),
      robust2_(options.robust_sigmas * options.robust_sigmas) {
  add_regularisation(graph, options.regularisation);
  for (const auto& each : problem.constraints) add_constraint(graph, each, Kind::kConstraint);
  for (const auto& each : problem.pins) add_constraint(graph, each, Kind::kPin);
  make_pattern();
}

void DeformationEnergy::add_regularisation(const DeformationGraph& graph, double weight) {
  const auto add = [&](std::size_t n, std::size_t m) {
    const Eigen::Vector3d apart =
        (graph.nodes()[m].position - graph.nodes()[n].position) / spacing_;
    Term term{.kind = Kind::kRegularisation};
    term.add(n, apart.homogeneous());
    term.add(m, -Eigen::Vector4d::UnitW());
    term.constant = -apart;
    term.information = weight * Eigen::Matrix3d::Identity();
    terms_.push_back(std::move(term));
  };
  for (const auto& [n, m] : graph.edges()) {
    add(static_cast<std::size_t>(n), static_cast<std::size_t>(m));
    add(static_cast<std::size_t>(m), static_cast<std::size_t>(n));
  }
}

void DeformationEnergy::add_constraint(const DeformationGraph& graph,
                                       const DeformationConstraint& constraint, Kind kind) {
  Term term{.kind = kind};
  const auto add_moved = [&](const Eigen::Vector3d& point, const TimeSpan& seen, double sign) {
    const Influences near = graph.influences(point, seen);
    for (std::size_t i = 0; i < static_cast<std::size_t>(near.count); ++i) {
      const auto n = static_cast<std::size_t>(near.node[i]);
      const Eigen::Vector3d& position = graph.nodes()[n].position;
      const double weight = sign * near.weight[i];
      term.add(n, weight * ((point - position) / spacing_).homogeneous());
      term.constant += weight * position / spacing_;
    }
  };
  add_moved(constraint.source, constraint.source_seen, 1);
  if (constraint.destination_seen) {
    add_moved(constraint.destination, *constraint.destination_seen, -1);
  } else {
    term.constant -= constraint.destination / spacing_;
  }
  term.information = spacing_ * spacing_ * constraint.information;
  term.largest_information =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(term.information, Eigen::EigenvaluesOnly)
          .eigenvalues()
          .maxCoeff();
  terms_.push_back(std::move(term));
}

void DeformationEnergy::make_pattern() {
  const auto block_of = [](std::size_t a, std::size_t b) {
    return std::pair(static_cast<std::int32_t>(std::max(a, b)),
                     static_cast<std::int32_t>(std::min(a, b)));
  };
  for (std::size_t n = 0; n < nodes_; ++n) pattern_.push_back(block_of(n, n));
  for (const Term& term : terms_) {
    for (std::size_t i = 0; i < term.count; ++i) {
      for (std::size_t j = 0; j < i; ++j) {
        pattern_.push_back(block_of(term.node[i], term.node[j]));
      }
    }
  }
  std::sort(pattern_.begin(), pattern_.end());
  pattern_.erase(std::unique(pattern_.begin(), pattern_.end()), pattern_.end());
  const auto find = [&](std::size_t a, std::size_t b) {
    const auto at = std::lower_bound(pattern_.begin(), pattern_.end(), block_of(a, b));
    return static_cast<std::size_t>(at - pattern_.begin());
  };
  for (std::size_t n = 0; n < nodes_; ++n) diagonal_.push_back(find(n, n));
  for (Term& term : terms_) {
    for (std::size_t i = 0; i < term.count; ++i) {
      for (std::size_t j = 0; j <= i; ++j) {
        term.blocks.push_back(find(term.node[i], term.node[j]));
      }
    }
  }
}

Eigen::Vector3d DeformationEnergy::residual(const Term& term, const Eigen::VectorXd& x) const {
  Eigen::Vector3d sum = term.constant;
  for (std::size_t i = 0; i < term.count; ++i) sum += rows_of(x, term.node[i]) * term.u[i];
  return sum;
}

DeformationEnergyTerms DeformationEnergy::value(const Eigen::VectorXd& x) const {
  DeformationEnergyTerms sum;
  for (std::size_t n = 0; n < nodes_; ++n) {
    const Eigen::Matrix3d affine = rows_of(x, n).leftCols<3>();
    sum.rotation +=
        rotation_ * (affine.transpose() * affine - Eigen::Matrix3d::Identity()).squaredNorm();
  }
  for (const Term& term : terms_) {
    const Eigen::Vector3d r = residual(term, x);
    const double square = r.dot(term.information * r);
    switch (term.kind) {
      case Kind::kRegularisation:
        sum.regularisation += square;
        break;
      case Kind::kConstraint:
        sum.constraints += robust2_ > 0 ? robust2_ * std::log1p(square / robust2_) : square;
        break;
      case Kind::kPin:
        sum.pins += square;
        break;
    }
  }
  return sum;
}

void DeformationEnergy::equations(const Eigen::VectorXd& x, Eigen::VectorXd& gradient,
                                  std::vector<NodeBlock>& blocks) const {
  gradient.setZero(x.size());
  blocks.assign(pattern_.size(), NodeBlock::Zero());
  const auto gradient_of = [&gradient](std::size_t node) {
    return Eigen::Map<Rows>(gradient.data() + node * kNodeUnknowns);
  };
  for (std::size_t n = 0; n < nodes_; ++n) {
    // With S = R^T R - 1: dS = dR^T R + R^T dR, half the energy's gradient is 2 R S.
    const Eigen::Matrix3d affine = rows_of(x, n).leftCols<3>();
    gradient_of(n).leftCols<3>() =
        2 * rotation_ * affine * (affine.transpose() * affine - Eigen::Matrix3d::Identity());
    const Eigen::Matrix3d outer = affine * affine.transpose();
    NodeBlock& block = blocks[diagonal_[n]];
    for (int a = 0; a < 3; ++a) {
      for (int b = 0; b < 3; ++b) {
        for (int c = 0; c < 3; ++c) {
          block(4 * a + b, 4 * c + b) += 2 * rotation_ * outer(a, c);
          for (int d = 0; d < 3; ++d) {
            block(4 * a + b, 4 * c + d) += 2 * rotation_ * affine(a, d) * affine(c, b);
          }
        }
      }
    }
  }
  for (const Term& term : terms_) {
    const Eigen::Vector3d r = residual(term, x);
    Eigen::Matrix3d information = term.information;
    if (term.kind == Kind::kConstraint && robust2_ > 0) {
      information /= 1 + r.dot(information * r) / robust2_;
    }
    const Eigen::Vector3d pull = information * r;
    auto block = term.blocks.begin();
    for (std::size_t i = 0; i < term.count; ++i) {
      gradient_of(term.node[i]) += pull * term.u[i].transpose();
      for (std::size_t j = 0; j <= i; ++j) {
        // The blocks below the diagonal are kept.
        const bool is_below = term.node[i] >= term.node[j];
        add_product(information, term.u[is_below ? i : j], term.u[is_below ? j : i],
                    blocks[*block++]);
      }
    }
  }
}

double DeformationEnergy::error(const Term& term, const Eigen::VectorXd& x) const {
  if (term.largest_information == 0) return 0;
  const Eigen::Vector3d r = residual(term, x);
  return spacing_ * std::sqrt(r.dot(term.information * r) / term.largest_information);
}

double DeformationEnergy::mean_constraint_error(const Eigen::VectorXd& x) const {
  double sum = 0;
  int count = 0;
  for (const Term& term : terms_) {
    if (term.kind != Kind::kConstraint) continue;
    sum += error(term, x);
    ++count;
  }
  return count > 0 ? sum / count : 0;
}

double DeformationEnergy::largest_pin_error(const Eigen::VectorXd& x) const {
  double largest = 0;
  for (const Term& term : terms_) {
    if (term.kind == Kind::kPin) largest = std::max(largest, error(term, x));
  }
  return largest;
}

}  // namespace gastronaut::slam

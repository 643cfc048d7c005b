#include "visual_slam/deformation_solver.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "deformation_scene.hpp"
#include "geometry/se3.hpp"
#include "numerics/counter_random.hpp"
#include "visual_slam/deformation_energy.hpp"

namespace gastronaut::slam {
namespace {

using testing::HasSubstr;

constexpr double kWidth = 60 * kMillimetre;
constexpr double kLength = 40 * kMillimetre;
constexpr double kSigma = kSpacing / 10;  // of constraints: the paper's weight of 100
const Eigen::Matrix3d kInformation = Eigen::Matrix3d::Identity() / (kSigma * kSigma);
// The solver ends at changes of 1e-4 of a spacing, and converges faster than linearly.
constexpr double kSolved = 1e-4 * kSpacing;

struct Sheet {
  SurfelArrays surfels = sheet(kWidth, kLength);
  DeformationGraph graph = DeformationGraph::sample(surfels, graph_options());
};

DeformationConstraint constraint(const Eigen::Vector3d& source, const Eigen::Vector3d& destination,
                                 const TimeSpan& seen = {}) {
  return {source, seen, destination, {}, kInformation};
}

// The sheet's points on a grid of this distance are to go where `move` takes them.
template <class Move>
DeformationProblem problem_of(double distance, const Move& move) {
  DeformationProblem problem;
  for (int i = 0; i <= std::lround(kWidth / distance); ++i) {
    for (int j = 0; j <= std::lround(kLength / distance); ++j) {
      const Eigen::Vector3d point(i * distance - kWidth / 2, j * distance - kLength / 2, 0);
      problem.constraints.push_back(constraint(point, move(point)));
    }
  }
  return problem;
}

DeformationReport solve(const DeformationProblem& problem, DeformationGraph& graph,
                        const DeformationSolverOptions& options = {}) {
  return DeformationSolver(options).solve(problem, graph);
}

template <class Move>
double largest_error(const SurfelArrays& before, const DeformationGraph& graph, const Move& move) {
  SurfelArrays surfels = before;
  graph.apply(surfels);
  double largest = 0;
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    largest = std::max(largest, (position_of(surfels, k) - move(position_of(before, k))).norm());
  }
  return largest;
}

TEST(BlockCholesky, SolvesWhatADenseOneDoes) {
  // A ring with a chord: fill-in is needed.
  constexpr int kNodes = 9;
  const BlockPattern pattern = {{0, 0}, {1, 0}, {1, 1}, {2, 1}, {2, 2}, {3, 2}, {3, 3},
                                {4, 3}, {4, 4}, {5, 4}, {5, 5}, {6, 1}, {6, 5}, {6, 6},
                                {7, 6}, {7, 7}, {8, 0}, {8, 7}, {8, 8}};
  const CounterRandom random(3, 0);
  constexpr int kSize = kNodes * kNodeUnknowns;
  Eigen::MatrixXd dense = Eigen::MatrixXd::Zero(kSize, kSize);
  std::vector<NodeBlock> blocks;
  std::uint64_t number = 0;
  for (const auto& [row, column] : pattern) {
    NodeBlock block = NodeBlock::NullaryExpr([&] { return random.normal(number++); });
    // Larger than the sum of all else in a row: positive definite.
    if (row == column) {
      block = (block + block.transpose()).eval() + 200 * NodeBlock::Identity();
    }
    blocks.push_back(block);
    dense.block<kNodeUnknowns, kNodeUnknowns>(row * kNodeUnknowns, column * kNodeUnknowns) = block;
    dense.block<kNodeUnknowns, kNodeUnknowns>(column * kNodeUnknowns, row * kNodeUnknowns) =
        block.transpose();
  }
  constexpr double kDamping = 0.5;
  dense.diagonal().array() += kDamping;
  const Eigen::VectorXd right =
      Eigen::VectorXd::NullaryExpr(kSize, [&] { return random.normal(number++); });
  BlockCholesky cholesky;
  cholesky.set_pattern(kNodes, pattern);
  ASSERT_TRUE(cholesky.factorise(blocks, kDamping));
  constexpr double kRounding = 1e-13;  // of numbers of about 0.01
  EXPECT_LT((cholesky.solve(right) - dense.llt().solve(right)).lpNorm<Eigen::Infinity>(),
            kRounding);
  EXPECT_FALSE(cholesky.factorise(blocks, -1000));
}

class DeformationDerivatives : public testing::Test {
 protected:
  DeformationDerivatives() {
    for (int n = 0; n < 7; ++n) {
      DeformationNode node;
      node.position = kSpacing * Eigen::Vector3d(n % 3, n / 3, 0.3 * (n % 2));
      nodes_.push_back(node);
    }
    const Eigen::Vector3d sigmas(0.3, 1, 2);
    Eigen::Matrix3d information = sigmas.asDiagonal();
    information += 0.2 * Eigen::Matrix3d::Ones();
    information /= kSpacing * kSpacing;
    const auto at = [](double x, double y, double z) {
      return Eigen::Vector3d(kSpacing * Eigen::Vector3d(x, y, z));
    };
    problem_.constraints = {{at(0.4, 0.3, 0), {}, at(0.2, 0.5, 0.4), {}, information},
                            {at(1.4, 1.3, 0), {}, at(0.3, 0.1, 0.2), TimeSpan{}, information}};
    problem_.pins = {{at(1, 1, 0), {}, at(1, 1, 0.3), {}, 3 * information}};
  }

  // Rotations, or affine motions, that differ from node to node.
  Eigen::VectorXd state(bool is_rigid) const {
    const CounterRandom random(4, 0);
    Eigen::VectorXd x(std::ssize(nodes_) * kNodeUnknowns);
    for (std::size_t n = 0; n < nodes_.size(); ++n) {
      Eigen::Matrix<double, 3, 4, Eigen::RowMajor> rows;
      const auto number = [&](int i) { return 0.3 * random.normal(20 * n + std::uint64_t(i)); };
      rows << so3_exp({number(0), number(1), number(2)}).toRotationMatrix(),
          Eigen::Vector3d(number(3), number(4), number(5));
      if (!is_rigid) {
        rows.leftCols<3>() +=
            Eigen::Matrix3d::NullaryExpr([&](int i, int j) { return number(6 + 3 * i + j); });
      }
      x.segment<kNodeUnknowns>(static_cast<Eigen::Index>(n) * kNodeUnknowns) =
          Eigen::Map<Eigen::Matrix<double, kNodeUnknowns, 1>>(rows.data());
    }
    return x;
  }

  std::vector<DeformationNode> nodes_;
  DeformationProblem problem_;
};

// Central differences: truncation and rounding are both about step^2 of values of about 100.
constexpr double kStep = 1e-5;
constexpr double kDifference = 1e-6;

TEST_F(DeformationDerivatives, GradientIsThatOfTheEnergy) {
  for (const double robust_sigmas : {0.0, 0.5}) {
    DeformationSolverOptions options;
    options.robust_sigmas = robust_sigmas;
    const DeformationEnergy energy(DeformationGraph(nodes_, graph_options()), problem_, options);
    const Eigen::VectorXd x = state(false);
    Eigen::VectorXd gradient;
    std::vector<NodeBlock> blocks;
    energy.equations(x, gradient, blocks);
    for (Eigen::Index i = 0; i < x.size(); ++i) {
      const Eigen::VectorXd step = kStep * Eigen::VectorXd::Unit(x.size(), i);
      const double numeric =
          (energy.value(x + step).total() - energy.value(x - step).total()) / (4 * kStep);
      EXPECT_NEAR(gradient[i], numeric, kDifference) << "unknown " << i;
    }
  }
}

TEST_F(DeformationDerivatives, MatrixIsThatOfTheGradientWhereGaussNewtonIsExact) {
  // Only the rotation's residuals are not linear, and they are 0 where all nodes are rigid.
  const DeformationEnergy energy(DeformationGraph(nodes_, graph_options()), problem_, {});
  const Eigen::VectorXd x = state(true);
  Eigen::VectorXd gradient;
  std::vector<NodeBlock> blocks;
  energy.equations(x, gradient, blocks);
  Eigen::MatrixXd matrix = Eigen::MatrixXd::Zero(x.size(), x.size());
  for (std::size_t k = 0; k < blocks.size(); ++k) {
    const auto [row, column] = energy.pattern()[k];
    matrix.block<kNodeUnknowns, kNodeUnknowns>(row * kNodeUnknowns, column * kNodeUnknowns) =
        blocks[k];
    matrix.block<kNodeUnknowns, kNodeUnknowns>(column * kNodeUnknowns, row * kNodeUnknowns) =
        blocks[k].transpose();
  }
  for (Eigen::Index i = 0; i < x.size(); ++i) {
    const Eigen::VectorXd step = kStep * Eigen::VectorXd::Unit(x.size(), i);
    Eigen::VectorXd above, below;
    std::vector<NodeBlock> unused;
    energy.equations(x + step, above, unused);
    energy.equations(x - step, below, unused);
    EXPECT_LT(((above - below) / (2 * kStep) - matrix.col(i)).lpNorm<Eigen::Infinity>(),
              kDifference)
        << "unknown " << i;
  }
}

TEST(DeformationSolver, SatisfiedConstraintsBendNothing) {
  Sheet sheet;
  const DeformationReport report =
      solve(problem_of(10 * kMillimetre, [](const auto& p) { return p; }), sheet.graph);
  EXPECT_TRUE(report.is_accepted()) << report.refusal;
  constexpr double kRounding = 1e-12;  // metres
  EXPECT_LT(largest_error(sheet.surfels, sheet.graph, [](const auto& p) { return p; }), kRounding);
}

TEST(DeformationSolver, RigidMotionIsRecovered) {
  Sheet sheet;
  const SE3 motion{so3_exp({0.4, -0.7, 0.5}),
                   {8 * kMillimetre, -5 * kMillimetre, 12 * kMillimetre}};
  const auto move = [&](const Eigen::Vector3d& p) -> Eigen::Vector3d { return motion * p; };
  const DeformationReport report = solve(problem_of(10 * kMillimetre, move), sheet.graph);
  EXPECT_TRUE(report.is_accepted()) << report.refusal;
  EXPECT_LT(largest_error(sheet.surfels, sheet.graph, move), kSolved);
  EXPECT_LT(report.mean_error_after, kSolved);
  EXPECT_GT(report.mean_error_before, 12 * kMillimetre);
  const SE3 camera{so3_exp({0.2, 0, 0}), {0, 0, 30 * kMillimetre}};
  const SE3 moved = sheet.graph.moved(camera, {});
  EXPECT_LT((moved.translation - move(camera.translation)).norm(), 10 * kSolved);  // the lever
  EXPECT_LT(angle_between(moved.rotation, motion.rotation * camera.rotation), 1e-4);
}

// Onto a cylinder about an axis along y above the sheet.
constexpr double kCylinder = 40 * kMillimetre;
Eigen::Vector3d bent(const Eigen::Vector3d& p) {
  const double angle = p.x() / kCylinder;
  const double radius = kCylinder - p.z();
  return {radius * std::sin(angle), p.y(), kCylinder - radius * std::cos(angle)};
}

TEST(DeformationSolver, SheetBentOverACylinderIsPredictedBetweenTheConstraints) {
  Sheet sheet;
  constexpr double kApart = 10 * kMillimetre;
  DeformationProblem problem = problem_of(kApart, bent);
  // The points are exact. At the paper's weight the sheet's stiffness would flatten the arc.
  for (auto& each : problem.constraints) each.information *= 100;
  const DeformationReport report = solve(problem, sheet.graph);
  EXPECT_TRUE(report.is_accepted()) << report.refusal;
  // Between two constraints the sheet may stay as flat as their chord, which departs from the arc
  // by its height over it; and each node takes along a flat piece, which is tangent to the arc and
  // departs from it by that much at the next node.
  const double chord = kApart * kApart / (8 * kCylinder);
  const double tangent = kSpacing * kSpacing / (2 * kCylinder);
  EXPECT_LT(largest_error(sheet.surfels, sheet.graph, bent), chord + tangent);
  // The same for normals: the chord is off by half the angle between constraints at its ends, a
  // node's piece by half that between nodes where the next one takes over.
  SurfelArrays surfels = sheet.surfels;
  sheet.graph.apply(surfels);
  double largest_angle = 0;
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    const double angle = position_of(sheet.surfels, k).x() / kCylinder;
    const Eigen::Vector3d normal(-std::sin(angle), 0, std::cos(angle));
    const double cosine = std::min(1.0, normal_of(surfels, k).dot(normal));
    largest_angle = std::max(largest_angle, std::acos(cosine));
  }
  EXPECT_LT(largest_angle, (kApart + kSpacing) / 2 / kCylinder);
}

TEST(DeformationSolver, DistancesAlongANormalAreEnoughToRaiseTheSheet) {
  // Point to plane: nothing is said about sideways, and nothing moves there.
  Sheet sheet;
  const Eigen::Vector3d up(0, 0, 2 * kMillimetre);
  const auto move = [&](const Eigen::Vector3d& p) -> Eigen::Vector3d { return p + up; };
  DeformationProblem problem = problem_of(10 * kMillimetre, move);
  for (auto& each : problem.constraints) {
    each.destination.x() += 3 * kMillimetre;
    each.information = Eigen::Vector3d(0, 0, 1 / (kSigma * kSigma)).asDiagonal();
  }
  const DeformationReport report = solve(problem, sheet.graph);
  EXPECT_TRUE(report.is_accepted()) << report.refusal;
  EXPECT_NEAR(report.mean_error_before, up.norm(), kSolved);
  EXPECT_LT(largest_error(sheet.surfels, sheet.graph, move), kSolved);
}

TEST(DeformationSolver, LengthsMeanTheSameInARoom) {
  // The same problem forty times as large has the same solution.
  constexpr double kRoom = 40;
  Sheet sheet;
  DeformationProblem problem = problem_of(10 * kMillimetre, bent);
  DeformationGraphOptions options = graph_options();
  options.spacing *= kRoom;
  std::vector<DeformationNode> nodes = sheet.graph.nodes();
  for (DeformationNode& node : nodes) node.position *= kRoom;
  DeformationGraph room(nodes, options);
  solve(problem, sheet.graph);
  for (auto& each : problem.constraints) {
    each.source *= kRoom;
    each.destination *= kRoom;
    each.information /= kRoom * kRoom;
  }
  ASSERT_TRUE(solve(problem, room).is_accepted());
  constexpr double kRounding = 1e-6;  // through a few iterations
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    EXPECT_LT((room.nodes()[n].affine - sheet.graph.nodes()[n].affine).norm(), kRounding);
    EXPECT_LT((room.nodes()[n].translation - kRoom * sheet.graph.nodes()[n].translation).norm(),
              kRounding);
  }
}

TEST(DeformationSolver, NodesThatNothingHoldsStay) {
  Sheet sheet;
  std::vector<DeformationNode> nodes = sheet.graph.nodes();
  for (int k = 0; k < 3; ++k) {
    DeformationNode& node = nodes.emplace_back();
    node.position = Eigen::Vector3d(k, 1, 1);
    node.seen = TimeSpan::at((100 + 10 * k) * kSecond);
  }
  DeformationGraph graph(nodes, graph_options());
  const DeformationReport report = solve(problem_of(10 * kMillimetre, bent), graph);
  EXPECT_TRUE(report.is_accepted()) << report.refusal;
  for (std::size_t n = nodes.size() - 3; n < nodes.size(); ++n) {
    EXPECT_TRUE(graph.nodes()[n].affine.isIdentity(0));
    EXPECT_TRUE(graph.nodes()[n].translation.isZero(0));
  }
  EXPECT_LT(report.mean_error_after, 0.1 * report.mean_error_before);
}

// A ring walked once round and a little on. Height is lost steadily, so that what is seen again
// lies a drift above what was seen first.
class DriftingRing : public testing::Test {
 protected:
  static constexpr double kRadius = 30 * kMillimetre;
  static constexpr double kRingWidth = 12 * kMillimetre;
  static constexpr double kOverlap = 0.8;  // radians
  static constexpr double kDrift = 2 * kMillimetre;
  static constexpr double kTurn = 2 * std::numbers::pi;

  DriftingRing() {
    for (double angle = 0; angle < kTurn + kOverlap; angle += kSurfelDistance / kRadius) {
      for (double out = 0; out <= kRingWidth; out += kSurfelDistance) {
        add_surfel(surfels_, point(angle, out), Eigen::Vector3d::UnitZ(), seen(angle));
      }
    }
    graph_ = DeformationGraph::sample(surfels_, graph_options());
    for (double angle = 0.1; angle < kOverlap; angle += 0.1) {
      for (double out = 0; out <= kRingWidth; out += 3 * kMillimetre) {
        const Eigen::Vector3d old = point(angle, out);
        problem_.constraints.push_back(
            {point(kTurn + angle, out), seen(kTurn + angle), old, seen(angle), kInformation});
        problem_.pins.push_back({old, seen(angle), old, {}, kInformation});
      }
    }
  }
  static Eigen::Vector3d point(double angle, double out) {
    return {(kRadius + out) * std::cos(angle), (kRadius + out) * std::sin(angle),
            kDrift * angle / kTurn};
  }
  static TimeSpan seen(double angle) {
    const auto time = static_cast<std::int64_t>(10 * angle * static_cast<double>(kSecond));
    return {time, time + kSecond};
  }

  SurfelArrays surfels_;
  DeformationGraph graph_{{}, graph_options()};
  DeformationProblem problem_;
};

TEST_F(DriftingRing, TwoLayersBecomeOneAndTheDriftIsSpread) {
  const DeformationReport report = solve(problem_, graph_);
  ASSERT_TRUE(report.is_accepted()) << report.refusal;
  EXPECT_NEAR(report.mean_error_before, kDrift, kSolved);
  // Far below what a constraint's sigma allows: hundreds of them pull the same way.
  EXPECT_LT(report.mean_error_after, kSigma / 5);
  EXPECT_LT(report.largest_pin_error, kSigma / 5);
  SurfelArrays surfels = surfels_;
  graph_.apply(surfels);
  double before = 0;
  double after = 0;
  double steepest = 0;
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    before += std::pow(position_of(surfels_, k).z(), 2);
    after += std::pow(position_of(surfels, k).z(), 2);
    steepest = std::max(steepest, 1 - normal_of(surfels, k).z());
  }
  // The truth is flat. The start keeps its wrong slope, which only the second visit contradicts.
  EXPECT_LT(std::sqrt(after), 0.5 * std::sqrt(before));
  // Nowhere a step: a drift over four spacings would be as steep as this.
  EXPECT_LT(steepest, 1 - std::cos(kDrift / (4 * kSpacing)));
}

TEST_F(DriftingRing, LayersMeetHalfwayWhenNothingIsPinned) {
  problem_.pins.clear();
  const DeformationReport report = solve(problem_, graph_);
  ASSERT_TRUE(report.is_accepted()) << report.refusal;
  EXPECT_LT(report.mean_error_after, kSigma / 5);
  // Nothing says which of the two is right, so neither does all of the way.
  double early = 0;
  double late = 0;
  for (const auto& each : problem_.constraints) {
    early += (graph_.moved(each.destination, *each.destination_seen) - each.destination).z();
    late += (graph_.moved(each.source, each.source_seen) - each.source).z();
  }
  const double count = static_cast<double>(problem_.constraints.size());
  EXPECT_NEAR(early / count, kDrift / 2, kDrift / 4);
  EXPECT_NEAR(late / count, -kDrift / 2, kDrift / 4);
}

TEST_F(DriftingRing, PinnedPartHoldsWhileTheOtherMoves) {
  for (auto& pin : problem_.pins) pin.information *= 100;
  for (auto& each : problem_.constraints) each.destination_seen.reset();
  ASSERT_TRUE(solve(problem_, graph_).is_accepted());
  for (const auto& pin : problem_.pins) {
    EXPECT_LT((graph_.moved(pin.source, pin.source_seen) - pin.source).norm(), kSigma / 10);
  }
  for (const auto& each : problem_.constraints) {
    EXPECT_GT((graph_.moved(each.source, each.source_seen) - each.source).norm(), kDrift / 2);
  }
}

TEST_F(DriftingRing, MagnetHoldsTheCameraInPlace) {
  // Halfway round, where nothing is seen twice, the camera's place is known by its magnet.
  const double angle = kTurn / 2;
  const Eigen::Vector3d camera = point(angle, kRingWidth / 2) + Eigen::Vector3d(0, 0, 0.02);
  const Eigen::Vector3d known = camera - Eigen::Vector3d(0, 0, kDrift / 2);
  constexpr double kMagnetSigma = 0.1 * kMillimetre;
  problem_.pins.push_back({camera,
                           seen(angle),
                           known,
                           {},
                           Eigen::Matrix3d::Identity() / (kMagnetSigma * kMagnetSigma)});
  ASSERT_TRUE(solve(problem_, graph_).is_accepted());
  EXPECT_LT((graph_.moved(camera, seen(angle)) - known).norm(), kMagnetSigma);
}

TEST_F(DriftingRing, SymbolicFactorisationIsReused) {
  DeformationSolver solver{{}};
  DeformationGraph graph = graph_;
  const DeformationReport first = solver.solve(problem_, graph);
  EXPECT_GT(first.iterations, 1);
  EXPECT_EQ(solver.symbolic_factorisations(), 1);
  // Other places to go to, the same nodes.
  for (auto& each : problem_.constraints) each.destination.z() += 0.1 * kMillimetre;
  graph = graph_;
  EXPECT_TRUE(solver.solve(problem_, graph).is_accepted());
  EXPECT_EQ(solver.symbolic_factorisations(), 1);
  // Others are tied.
  problem_.constraints[0].source = point(kTurn / 2, 0);
  problem_.constraints[0].source_seen = seen(kTurn / 2);
  graph = graph_;
  solver.solve(problem_, graph);
  EXPECT_EQ(solver.symbolic_factorisations(), 2);
}

TEST_F(DriftingRing, OneWrongConstraintIsOutvoted) {
  problem_.constraints[0].destination_seen.reset();
  problem_.constraints[0].destination.z() += 20 * kMillimetre;
  DeformationGraph pulled = graph_;
  solve(problem_, pulled);
  DeformationSolverOptions options;
  options.robust_sigmas = 3;
  const DeformationReport report = solve(problem_, graph_, options);
  ASSERT_TRUE(report.is_accepted()) << report.refusal;
  const auto gap = [this](const DeformationGraph& graph) {
    const auto& near = problem_.constraints[1];
    return (graph.moved(near.source, near.source_seen) -
            graph.moved(near.destination, *near.destination_seen))
        .norm();
  };
  EXPECT_LT(gap(graph_), kSigma);
  EXPECT_GT(gap(pulled), 2 * gap(graph_));
}

class RefusedDeformation : public testing::Test {
 protected:
  // The reason; the graph must be as it was.
  std::string refusal(const DeformationProblem& problem,
                      const DeformationSolverOptions& options = {}) {
    DeformationGraph graph = sheet_.graph;
    const DeformationReport report = solve(problem, graph, options);
    SurfelArrays surfels = sheet_.surfels;
    EXPECT_TRUE(graph.apply(surfels).empty());
    return report.refusal;
  }
  Sheet sheet_;
  DeformationProblem good_ = problem_of(10 * kMillimetre, bent);
};

TEST_F(RefusedDeformation, WithoutNodes) {
  DeformationGraph empty({}, graph_options());
  EXPECT_THAT(solve(good_, empty).refusal, HasSubstr("no nodes"));
}

TEST_F(RefusedDeformation, TooFewConstraints) {
  good_.constraints.resize(5);
  EXPECT_THAT(refusal(good_), HasSubstr("5 constraints, fewer than 6"));
}

TEST_F(RefusedDeformation, ConstraintsOnALine) {
  for (auto& each : good_.constraints) each.source.y() = 0;
  EXPECT_THAT(refusal(good_), HasSubstr("on a line"));
  for (auto& each : good_.constraints) each.source.x() = 0;
  EXPECT_THAT(refusal(good_), HasSubstr("a point"));
}

TEST_F(RefusedDeformation, WhatIsNotANumber) {
  DeformationProblem problem = good_;
  problem.constraints[3].destination.z() = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(refusal(problem), HasSubstr("not a number"));
  problem = good_;
  problem.pins.push_back(constraint({0, 0, 0}, {0, 0, 0}));
  problem.pins[0].information(1, 1) = -1;
  EXPECT_THAT(refusal(problem), HasSubstr("negative"));
}

TEST_F(RefusedDeformation, NoConvergence) {
  DeformationSolverOptions options;
  options.iterations = 1;
  EXPECT_THAT(refusal(good_, options), HasSubstr("no convergence in 1 iterations"));
}

TEST_F(RefusedDeformation, FoldedOver) {
  // One half is to lie on the other.
  const auto fold = [](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(std::abs(p.x()), p.y(), p.z());
  };
  EXPECT_THAT(refusal(problem_of(5 * kMillimetre, fold)), HasSubstr("fold"));
}

TEST_F(RefusedDeformation, TornApart) {
  const auto tear = [](const Eigen::Vector3d& p) {
    return Eigen::Vector3d(p.x() + (p.x() > 0 ? 20 * kMillimetre : 0), p.y(), p.z());
  };
  EXPECT_THAT(refusal(problem_of(5 * kMillimetre, tear)), HasSubstr("tear"));
}

}  // namespace
}  // namespace gastronaut::slam

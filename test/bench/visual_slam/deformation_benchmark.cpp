// Bending a map: the optimisation of 500 nodes and 500 constraints, beside Ceres on the same energy
// with the same result; sampling the nodes and moving the surfels of maps of 0.1 and 2 million. Two
// threads.
#include <benchmark/benchmark.h>
#include <ceres/ceres.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "numerics/parallel.hpp"
#include "visual_slam/deformation_graph.hpp"
#include "visual_slam/deformation_solver.hpp"

namespace gastronaut::slam {
namespace {

constexpr int kThreads = 2;
constexpr double kRadius = 0.0355;  // metres, of a cavity that takes 500 nodes
constexpr double kWave = 0.004;     // metres that a contraction of the wall moves it
constexpr std::uint64_t kConstraints = 500;
constexpr std::uint64_t kNodeSurfels = 100'000;

// Point k of `count` along a spiral that covers the unit sphere evenly: as in a map, those that
// follow each other are neighbours.
Eigen::Vector3d direction(std::uint64_t k, std::uint64_t count) {
  const auto n = static_cast<double>(count);
  const double from_pole = std::acos(1 - (2 * static_cast<double>(k) + 1) / n);
  const double round = std::sqrt(n * std::numbers::pi) * from_pole;
  return {std::sin(from_pole) * std::cos(round), std::sin(from_pole) * std::sin(round),
          std::cos(from_pole)};
}

SurfelArrays cavity(std::uint64_t count) {
  SurfelArrays surfels;
  surfels.resize(count);
  for (std::size_t k = 0; k < count; ++k) {
    const Eigen::Vector3f normal = -direction(k, count).cast<float>();
    const Eigen::Vector3f position = static_cast<float>(-kRadius) * normal;
    surfels.x[k] = position.x();
    surfels.y[k] = position.y();
    surfels.z[k] = position.z();
    surfels.nx[k] = normal.x();
    surfels.ny[k] = normal.y();
    surfels.nz[k] = normal.z();
    surfels.confidence[k] = 20;
    surfels.radius[k] = 2e-4F;
  }
  return surfels;
}

// A ring of the wall is drawn together.
DeformationProblem contraction(double spacing) {
  DeformationProblem problem;
  for (std::uint64_t k = 0; k < kConstraints; ++k) {
    const Eigen::Vector3d outwards = direction(k, kConstraints);
    const double inwards = kWave * std::exp(-std::pow(outwards.z() / 0.3, 2));
    problem.constraints.push_back({kRadius * outwards,
                                   {},
                                   (kRadius - inwards) * outwards,
                                   {},
                                   100 / (spacing * spacing) * Eigen::Matrix3d::Identity()});
  }
  return problem;
}

DeformationGraph graph_of_cavity() {
  return DeformationGraph::sample(cavity(kNodeSurfels), DeformationGraphOptions{});
}

using Motion = std::array<double, kNodeUnknowns>;  // rows of [R | t / spacing]

template <class T>
void move(const T* motion, const Eigen::Vector3d& from_node, double weight, T* sum) {
  for (int i = 0; i < 3; ++i) {
    const T* row = motion + 4 * i;
    sum[i] += weight *
              (row[0] * from_node.x() + row[1] * from_node.y() + row[2] * from_node.z() + row[3]);
  }
}

struct Orthonormality {
  template <class T>
  bool operator()(const T* motion, T* residual) const {
    for (int a = 0; a < 3; ++a) {
      for (int b = a; b < 3; ++b) {
        T product(a == b ? -1.0 : 0.0);
        for (int i = 0; i < 3; ++i) product += motion[4 * i + a] * motion[4 * i + b];
        *residual++ = (a == b ? 1.0 : std::numbers::sqrt2) * product;
      }
    }
    return true;
  }
};

struct Agreement {
  Eigen::Vector3d apart;  // of the neighbours, in spacings
  double factor;

  template <class T>
  bool operator()(const T* here, const T* there, T* residual) const {
    for (int i = 0; i < 3; ++i) residual[i] = -factor * (apart[i] + there[4 * i + 3]);
    move(here, apart, factor, residual);
    return true;
  }
};

struct Arrival {
  std::array<Eigen::Vector3d, kDeformationNeighbours> from_node;  // spacings
  std::array<double, kDeformationNeighbours> weight;
  Eigen::Vector3d rest;  // weighted node positions less the destination, spacings
  double factor;

  template <class T>
  bool operator()(const T* a, const T* b, const T* c, const T* d, T* residual) const {
    for (int i = 0; i < 3; ++i) residual[i] = T(factor * rest[i]);
    const T* const motions[kDeformationNeighbours] = {a, b, c, d};
    for (std::size_t i = 0; i < from_node.size(); ++i) {
      move(motions[i], from_node[i], factor * weight[i], residual);
    }
    return true;
  }
};

class Peer {
 public:
  Peer(const DeformationGraph& graph, const DeformationProblem& problem) {
    const DeformationSolverOptions weights;
    const auto& nodes = graph.nodes();
    motions_.assign(nodes.size(), kStill);
    for (Motion& motion : motions_) {
      problem_.AddResidualBlock(
          new ceres::AutoDiffCostFunction<Orthonormality, 6, kNodeUnknowns>(new Orthonormality),
          nullptr, motion.data());
    }
    const auto agree = [&](std::int32_t n, std::int32_t m) {
      const auto here = static_cast<std::size_t>(n);
      const auto there = static_cast<std::size_t>(m);
      problem_.AddResidualBlock(
          new ceres::AutoDiffCostFunction<Agreement, 3, kNodeUnknowns, kNodeUnknowns>(
              new Agreement{(nodes[there].position - nodes[here].position) / graph.spacing(),
                            std::sqrt(weights.regularisation)}),
          nullptr, motions_[here].data(), motions_[there].data());
    };
    for (const auto& [n, m] : graph.edges()) {
      agree(n, m);
      agree(m, n);
    }
    for (const DeformationConstraint& each : problem.constraints) {
      const Influences near = graph.influences(each.source, each.source_seen);
      auto* arrival = new Arrival{{},
                                  near.weight,
                                  -each.destination / graph.spacing(),
                                  graph.spacing() * std::sqrt(each.information(0, 0))};
      std::array<double*, kDeformationNeighbours> motions{};
      for (std::size_t i = 0; i < near.node.size(); ++i) {
        const auto n = static_cast<std::size_t>(near.node[i]);
        arrival->from_node[i] = (each.source - nodes[n].position) / graph.spacing();
        arrival->rest += near.weight[i] * nodes[n].position / graph.spacing();
        motions[i] = motions_[n].data();
      }
      problem_.AddResidualBlock(
          new ceres::AutoDiffCostFunction<Arrival, 3, kNodeUnknowns, kNodeUnknowns, kNodeUnknowns,
                                          kNodeUnknowns>(arrival),
          nullptr, motions[0], motions[1], motions[2], motions[3]);
    }
  }

  ceres::Solver::Summary solve() {
    std::fill(motions_.begin(), motions_.end(), kStill);
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    options.num_threads = kThreads;
    options.max_num_iterations = 100;
    options.function_tolerance = DeformationSolverOptions{}.least_gain;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem_, &summary);
    return summary;
  }

 private:
  static constexpr Motion kStill = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
  std::vector<Motion> motions_;
  ceres::Problem problem_;
};

void report(benchmark::State& state, const DeformationGraph& graph, int iterations, double energy) {
  state.counters["nodes"] = static_cast<double>(graph.nodes().size());
  state.counters["edges"] = static_cast<double>(graph.edges().size());
  state.counters["iterations"] = iterations;
  state.counters["energy"] = energy;
}

// All of it: influences, pattern, symbolic factorisation, iterations, checks.
void optimise(benchmark::State& state) {
  set_thread_count(kThreads);
  const DeformationGraph still = graph_of_cavity();
  const DeformationProblem problem = contraction(still.spacing());
  DeformationReport result;
  for (auto _ : state) {
    DeformationGraph graph = still;
    result = DeformationSolver(DeformationSolverOptions{}).solve(problem, graph);
  }
  if (!result.is_accepted()) state.SkipWithError(result.refusal.c_str());
  report(state, still, result.iterations, result.after.total());
}

// Of an existing problem: residuals and parameter blocks are set up before.
void optimise_with_ceres(benchmark::State& state) {
  const DeformationGraph still = graph_of_cavity();
  Peer peer(still, contraction(still.spacing()));
  ceres::Solver::Summary summary;
  for (auto _ : state) summary = peer.solve();
  report(state, still, static_cast<int>(summary.iterations.size()), 2 * summary.final_cost);
}

void sample(benchmark::State& state) {
  set_thread_count(kThreads);
  const SurfelArrays surfels = cavity(static_cast<std::uint64_t>(state.range(0)));
  for (auto _ : state) {
    benchmark::DoNotOptimize(DeformationGraph::sample(surfels, DeformationGraphOptions{}));
  }
}

// By a graph just made, whose search knows nothing yet.
void apply(benchmark::State& state) {
  set_thread_count(kThreads);
  DeformationGraph bent = graph_of_cavity();
  const DeformationReport result =
      DeformationSolver(DeformationSolverOptions{}).solve(contraction(bent.spacing()), bent);
  if (!result.is_accepted()) state.SkipWithError(result.refusal.c_str());
  const SurfelArrays before = cavity(static_cast<std::uint64_t>(state.range(0)));
  for (auto _ : state) {
    state.PauseTiming();
    const DeformationGraph graph(bent.nodes(), DeformationGraphOptions{});
    SurfelArrays surfels = before;
    state.ResumeTiming();
    benchmark::DoNotOptimize(graph.apply(surfels));
  }
}

BENCHMARK(optimise)->Unit(benchmark::kMillisecond)->UseRealTime();
BENCHMARK(optimise_with_ceres)->Unit(benchmark::kMillisecond)->UseRealTime();
BENCHMARK(sample)->Arg(100'000)->Arg(2'000'000)->Unit(benchmark::kMillisecond)->UseRealTime();
BENCHMARK(apply)->Arg(100'000)->Arg(2'000'000)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
}  // namespace gastronaut::slam

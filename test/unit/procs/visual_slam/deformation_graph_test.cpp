#include "visual_slam/deformation_graph.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <set>
#include <stdexcept>
#include <tuple>

#include "deformation_scene.hpp"
#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kWidth = 60 * kMillimetre;
constexpr double kLength = 40 * kMillimetre;
constexpr double kRounding = 1e-12;      // of doubles of about 1
constexpr double kFloatRounding = 1e-7;  // metres and units, of floats below 1
constexpr TimeSpan kEarly = {0, 5 * kSecond};
constexpr TimeSpan kLate = {60 * kSecond, 65 * kSecond};

const Eigen::Matrix3d kAffine =
    (Eigen::Matrix3d() << 1.1, 0.2, -0.1, 0.05, 0.9, 0.3, -0.2, 0.1, 1.2).finished();
const Eigen::Vector3d kTranslation(3 * kMillimetre, -2 * kMillimetre, 1 * kMillimetre);

// Every node's motion is x -> affine x + translation.
void move_all(DeformationGraph& graph, const Eigen::Matrix3d& affine,
              const Eigen::Vector3d& translation) {
  for (std::size_t n = 0; n < graph.nodes().size(); ++n) {
    const Eigen::Vector3d& g = graph.nodes()[n].position;
    graph.set_motion(n, affine, affine * g + translation - g);
  }
}

// Two layers of one sheet, a revisit apart in time, 2 mm apart in space.
SurfelArrays two_layers() {
  SurfelArrays surfels;
  add_sheet(surfels, kWidth, kLength, 0, kEarly);
  add_sheet(surfels, kWidth, kLength, 2 * kMillimetre, kLate);
  return surfels;
}

// Whether the graph's edges lead from `from` to node `to`.
bool are_tied(const DeformationGraph& graph, std::int32_t from, std::int32_t to) {
  std::set<std::int32_t> reached{from};
  for (bool grows = true; grows;) {
    grows = false;
    for (const auto& [a, b] : graph.edges()) {
      if (reached.contains(a) != reached.contains(b)) {
        reached.insert(a);
        reached.insert(b);
        grows = true;
      }
    }
  }
  return reached.contains(to);
}

Eigen::Vector3d random_point(const CounterRandom& random, std::uint64_t k) {
  return {kWidth * (random.uniform(3 * k) - 0.5), kLength * (random.uniform(3 * k + 1) - 0.5),
          kSpacing * (random.uniform(3 * k + 2) - 0.5)};
}

TEST(DeformationGraph, NodesLieEvenlyOverTheSurface) {
  const SurfelArrays surfels = sheet(kWidth, kLength);
  const DeformationGraph graph = DeformationGraph::sample(surfels, graph_options());
  for (const DeformationNode& a : graph.nodes()) {
    for (const DeformationNode& b : graph.nodes()) {
      if (&a == &b) continue;
      EXPECT_GE((a.position - b.position).norm(), kSpacing);
    }
  }
  // Every cell of half a spacing has its middle within a spacing of a node, and is no larger than
  // its diagonal.
  const double farthest = kSpacing * (1 + std::sqrt(3) / 2);
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    double nearest = farthest * 2;
    for (const DeformationNode& node : graph.nodes()) {
      nearest = std::min(nearest, (node.position - position_of(surfels, k)).norm());
    }
    EXPECT_LE(nearest, farthest);
  }
}

TEST(DeformationGraph, StraySurfelsMakeNoNodes) {
  SurfelArrays surfels = sheet(kWidth, kLength);
  const std::size_t nodes = DeformationGraph::sample(surfels, graph_options()).nodes().size();
  add_surfel(surfels, {0, 0, 20 * kMillimetre}, Eigen::Vector3d::UnitZ(), {});
  EXPECT_EQ(DeformationGraph::sample(surfels, graph_options()).nodes().size(), nodes);
  DeformationGraphOptions options = graph_options();
  options.least_confidence = 1000;
  EXPECT_TRUE(DeformationGraph::sample(surfels, options).nodes().empty());
}

TEST(DeformationGraph, RevisitHasNodesOfItsOwn) {
  const DeformationGraph graph = DeformationGraph::sample(two_layers(), graph_options());
  const auto nodes = graph.nodes();
  const auto early = std::count_if(nodes.begin(), nodes.end(), [](const DeformationNode& node) {
    return node.seen.first == kEarly.first && node.seen.last == kEarly.last;
  });
  EXPECT_EQ(2 * early, std::ssize(nodes));
  for (const auto& [a, b] : graph.edges()) {
    EXPECT_EQ(nodes[static_cast<std::size_t>(a)].seen.first,
              nodes[static_cast<std::size_t>(b)].seen.first);
  }
}

TEST(DeformationGraph, SurfaceSeenAllTheTimeIsOneLayer) {
  SurfelArrays surfels;
  add_sheet(surfels, kWidth, kLength, 0, {0, 60 * kSecond});
  const std::size_t nodes = DeformationGraph::sample(surfels, graph_options()).nodes().size();
  // Holes that were filled later, while the rest was still being seen.
  add_sheet(surfels, kWidth, kLength, 0, {50 * kSecond, 60 * kSecond});
  EXPECT_EQ(DeformationGraph::sample(surfels, graph_options()).nodes().size(), nodes);
}

TEST(DeformationGraph, LayersAreTiedThroughWhatWasSeenInBetween) {
  // From the first visit a strip leads away and back, each piece seen with the one before.
  SurfelArrays surfels = two_layers();
  constexpr double kStrip = 200 * kMillimetre;
  for (double at = 0; at < kStrip; at += kSurfelDistance) {
    const auto time = static_cast<std::int64_t>(60 * static_cast<double>(kSecond) * at / kStrip);
    const double x = kWidth / 2 + std::min(at, kStrip - at);
    for (double y = 0; y < 4 * kMillimetre; y += kSurfelDistance) {
      const double height = at < kStrip / 2 ? 0 : 2 * kMillimetre;
      add_surfel(surfels, {x, y, height}, Eigen::Vector3d::UnitZ(), {time, time + 2 * kSecond});
    }
  }
  const DeformationGraph graph = DeformationGraph::sample(surfels, graph_options());
  const auto& nodes = graph.nodes();
  const auto late = std::find_if(nodes.begin(), nodes.end(), [](const DeformationNode& node) {
    return node.seen.first == kLate.first && node.position.x() < 0;
  });
  ASSERT_NE(late, nodes.end());
  EXPECT_TRUE(are_tied(graph, 0, static_cast<std::int32_t>(late - nodes.begin())));
  const DeformationGraph without = DeformationGraph::sample(two_layers(), graph_options());
  EXPECT_FALSE(are_tied(without, 0, static_cast<std::int32_t>(without.nodes().size() - 1)));
}

TEST(DeformationGraph, ClustersSeenTogetherAreTied) {
  // Ten nodes each: a node's four nearest are all in its own cluster.
  std::vector<DeformationNode> nodes(20);
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    nodes[n].position = {kSpacing * static_cast<double>(n % 10) + (n < 10 ? 0 : 1), 0, 0};
  }
  const DeformationGraph graph(nodes, graph_options());
  EXPECT_TRUE(are_tied(graph, 0, 19));
}

TEST(DeformationGraph, WeightsFollowThePaper) {
  const DeformationGraph graph = DeformationGraph::sample(two_layers(), graph_options());
  const CounterRandom random(1, 0);
  constexpr std::uint64_t kPoints = 500;
  for (std::uint64_t k = 0; k < kPoints; ++k) {
    const Eigen::Vector3d point = random_point(random, k);
    const TimeSpan seen = k % 2 == 0 ? kEarly : kLate;
    std::vector<std::pair<double, std::int32_t>> near;
    for (std::size_t n = 0; n < graph.nodes().size(); ++n) {
      if (graph.nodes()[n].seen.first != seen.first) continue;
      near.emplace_back((graph.nodes()[n].position - point).norm(), static_cast<std::int32_t>(n));
    }
    std::sort(near.begin(), near.end());
    double sum = 0;
    std::vector<double> weights;
    for (int i = 0; i < kDeformationNeighbours; ++i) {
      const double rest = 1 - near[static_cast<std::size_t>(i)].first / near[4].first;
      weights.push_back(rest * rest);
      sum += weights.back();
    }
    const Influences found = graph.influences(point, seen);
    ASSERT_EQ(found.count, kDeformationNeighbours);
    EXPECT_NEAR(std::accumulate(found.weight.begin(), found.weight.end(), 0.0), 1, kRounding);
    for (std::size_t i = 0; i < weights.size(); ++i) {
      EXPECT_EQ(found.node[i], near[i].second);
      EXPECT_NEAR(found.weight[i], weights[i] / sum, kRounding);
    }
  }
}

TEST(DeformationGraph, FindsTheNearestAmongManyNodesOfOtherTimes) {
  // More layers than the search lists nodes around a cell: the wanted one is beyond the list.
  std::vector<DeformationNode> nodes;
  constexpr int kLayers = 300;
  for (int layer = 0; layer < kLayers; ++layer) {
    for (int n = 0; n < 6; ++n) {
      DeformationNode& node = nodes.emplace_back();
      node.position = {n * kSpacing, 0, layer == 0 ? 20 * kSpacing : 0};
      node.seen = TimeSpan::at(10 * kSecond * layer);
    }
  }
  const DeformationGraph graph(nodes, graph_options());
  const Influences found = graph.influences({0.1 * kSpacing, 0, 0}, TimeSpan::at(0));
  EXPECT_THAT(found.node, testing::ElementsAre(0, 1, 2, 3));
}

TEST(DeformationGraph, FewNodesOfThatTimeAreEnough) {
  std::vector<DeformationNode> nodes(8);
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    nodes[n].position = {kSpacing * static_cast<double>(n), 0, 0};
    nodes[n].seen = n < 2 ? kLate : kEarly;
  }
  const DeformationGraph graph(nodes, graph_options());
  const Influences late = graph.influences({3 * kSpacing, 0, 0}, kLate);
  EXPECT_EQ(late.count, 2);
  EXPECT_NEAR(late.weight[0] + late.weight[1], 1, kRounding);
  EXPECT_GT(late.weight[0], late.weight[1]);
  EXPECT_EQ(late.node[0], 1);
  // Nothing was seen then: those of the nearest time.
  const Influences never = graph.influences({0, 0, 0}, TimeSpan::at(50 * kSecond));
  for (int i = 0; i < 2; ++i) EXPECT_LT(never.node[static_cast<std::size_t>(i)], 2);
  EXPECT_EQ(DeformationGraph({}, graph_options()).influences({0, 0, 0}, kLate).count, 0);
}

TEST(DeformationGraph, UnmovedNodesLeaveEveryBit) {
  const SurfelArrays before = two_layers();
  DeformationGraph graph = DeformationGraph::sample(before, graph_options());
  SurfelArrays surfels = before;
  EXPECT_TRUE(graph.apply(surfels).empty());
  EXPECT_EQ(surfels, before);
  const SE3 pose{so3_exp({0.1, 0.2, 0.3}), {0.01, 0.02, 0.03}};
  EXPECT_EQ(graph.moved(pose, kEarly).matrix(), pose.matrix());

  // One node moves: all that does not follow it stays.
  graph.set_motion(0, kAffine, kTranslation);
  const std::vector<std::int32_t> moved = graph.apply(surfels);
  EXPECT_FALSE(moved.empty());
  const std::set<std::int32_t> ids(moved.begin(), moved.end());
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    const Influences near = graph.influences(position_of(before, k), seen_of(before, k));
    const bool follows = std::any_of(near.node.begin(), near.node.end(),
                                     [](std::int32_t node) { return node == 0; });
    if (!follows) {
      EXPECT_EQ(position_of(surfels, k), position_of(before, k));
    }
    EXPECT_EQ(ids.contains(static_cast<std::int32_t>(k)),
              position_of(surfels, k) != position_of(before, k) ||
                  normal_of(surfels, k) != normal_of(before, k));
  }
}

TEST(DeformationGraph, OnlyTheSurfelsAskedForTakePart) {
  const SurfelArrays before = two_layers();
  std::vector<std::int32_t> late;
  for (std::size_t k = 0; k < before.size(); ++k) {
    if (before.initialised[k] == kLate.first) late.push_back(static_cast<std::int32_t>(k));
  }
  DeformationGraph graph = DeformationGraph::sample(before, late, graph_options());
  ASSERT_FALSE(graph.nodes().empty());
  for (const DeformationNode& node : graph.nodes()) EXPECT_EQ(node.seen.first, kLate.first);
  move_all(graph, Eigen::Matrix3d::Identity(), kTranslation);
  SurfelArrays surfels = before;
  EXPECT_EQ(graph.apply(surfels, late), late);
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    if (before.initialised[k] == kLate.first) continue;
    EXPECT_EQ(position_of(surfels, k), position_of(before, k));
  }
}

TEST(DeformationGraph, OneAffineMotionOfAllNodesMovesEverythingByIt) {
  const SurfelArrays before = two_layers();
  DeformationGraph graph = DeformationGraph::sample(before, graph_options());
  move_all(graph, kAffine, kTranslation);
  SurfelArrays surfels = before;
  EXPECT_EQ(graph.apply(surfels).size(), before.size());
  const Eigen::Vector3d normal =
      (kAffine.inverse().transpose() * Eigen::Vector3d::UnitZ()).normalized();
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    const Eigen::Vector3d position = kAffine * position_of(before, k) + kTranslation;
    EXPECT_LT((position_of(surfels, k) - position).norm(), kFloatRounding);
    EXPECT_LT((normal_of(surfels, k) - normal).norm(), kFloatRounding);
  }
}

TEST(DeformationGraph, CameraTurnsByTheRotationInTheAffineMotion) {
  DeformationGraph graph = DeformationGraph::sample(sheet(kWidth, kLength), graph_options());
  const Eigen::Quaterniond turn = so3_exp({0.3, -0.2, 0.5});
  const Eigen::Matrix3d stretch = Eigen::Vector3d(1.2, 0.9, 1.1).asDiagonal();
  move_all(graph, turn * stretch, kTranslation);
  const SE3 pose{so3_exp({0.1, 0.2, 0.3}), {0, 0, 30 * kMillimetre}};
  const SE3 moved = graph.moved(pose, {});
  EXPECT_LT(angle_between(moved.rotation, turn * pose.rotation), kRounding);
  EXPECT_LT((moved.translation - (turn * (stretch * pose.translation) + kTranslation)).norm(),
            kRounding);
}

TEST(DeformationGraph, SameBytesWithOneAndTwoThreads) {
  const auto bent = [](int threads) {
    set_thread_count(threads);
    SurfelArrays surfels = two_layers();
    DeformationGraph graph = DeformationGraph::sample(surfels, graph_options());
    const CounterRandom random(2, 0);
    for (std::size_t n = 0; n < graph.nodes().size(); ++n) {
      graph.set_motion(n, kAffine, random_point(random, n));
    }
    const std::vector<std::int32_t> ids = graph.apply(surfels);
    set_thread_count(0);
    return std::pair(surfels, ids);
  };
  EXPECT_EQ(bent(1), bent(2));
}

TEST(DeformationGraph, ImpossibleOptionsAreRefused) {
  DeformationGraphOptions options = graph_options();
  options.spacing = 0;
  EXPECT_THROW(DeformationGraph({}, options), std::invalid_argument);
  EXPECT_THROW(DeformationGraph::sample({}, options), std::invalid_argument);
}

}  // namespace
}  // namespace gastronaut::slam

#include "visual_slam/map_deformer.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "unit/procs/visual_slam/deformation_scene.hpp"

namespace gastronaut::slam {
namespace {

// A camera above a plain sheet, looking straight down on it, and what it sees.
const PinholeGrid kGrid = {80, 60, 60, 60, 39.5, 29.5};
constexpr double kHeight = 0.03;  // metres
constexpr double kStep = 2e-3;    // metres of the camera along x each second

MapDeformerOptions options() {
  MapDeformerOptions options;
  options.working_distance = kHeight;
  return options;
}

SE3 camera_at(double x) {
  return {Eigen::Quaterniond(Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitX())), {x, 0, kHeight}};
}

Frame view_at(std::int64_t utime) {
  Frame frame;
  frame.utime = utime;
  frame.grid = kGrid;
  frame.depth = Plane<float>(kGrid.width, kGrid.height, static_cast<float>(kHeight));
  frame.albedo = Plane<float>(kGrid.width, kGrid.height, 0.5F);
  return frame;
}

KeyframePin pin_at(const SE3& map_T_camera, double std = 0.1 * kMillimetre) {
  KeyframePin pin{map_T_camera, Matrix6d::Identity()};
  pin.covariance.topLeftCorner<3, 3>() *= std * std;
  pin.covariance.bottomRightCorner<3, 3>() *= std / kHeight * std / kHeight;
  return pin;
}

// Seconds of keyframes, one a second; each pinned to where `shift` has its camera.
void drive(MapDeformer& deformer, int first, int seconds, const Eigen::Vector3d& shift,
           bool is_known_surface = false) {
  for (int k = first; k < first + seconds; ++k) {
    const SE3 camera = camera_at(kStep * (k - first));
    const SE3 pinned{camera.rotation, camera.translation + shift};
    deformer.add(view_at(k * kSecond), camera, is_known_surface, pin_at(pinned));
  }
}

double nearest_neighbour(const std::vector<DeformationNode>& nodes) {
  double nearest = std::numeric_limits<double>::infinity();
  for (auto a = nodes.begin(); a != nodes.end(); ++a) {
    for (auto b = a + 1; b != nodes.end(); ++b) {
      nearest = std::min(nearest, (a->position - b->position).norm());
    }
  }
  return nearest;
}

TEST(MapDeformer, NodesCoverWhatWasSeenEvenly) {
  MapDeformer deformer(options());
  drive(deformer, 0, 5, Eigen::Vector3d::Zero());
  const double spacing = options().spacing * kHeight;
  EXPECT_GE(nearest_neighbour(deformer.nodes()), spacing);
  // Each point of the picture has a node within reach.
  for (const double x : {-0.015, 0.0, 0.015}) {
    for (const double y : {-0.01, 0.0, 0.01}) {
      const bool is_covered = std::any_of(
          deformer.nodes().begin(), deformer.nodes().end(), [&](const DeformationNode& node) {
            return (node.position - Eigen::Vector3d(x, y, 0)).norm() < 1.5 * spacing;
          });
      EXPECT_TRUE(is_covered) << x << ' ' << y;
    }
  }
}

TEST(MapDeformer, SecondVisitHasNodesOfItsOwnUnlessTheSurfaceIsKnown) {
  MapDeformer apart(options());
  drive(apart, 0, 3, Eigen::Vector3d::Zero());
  MapDeformer known = apart;
  const std::size_t first = apart.nodes().size();
  drive(apart, 100, 3, Eigen::Vector3d::Zero());
  drive(known, 100, 3, Eigen::Vector3d::Zero(), true);
  EXPECT_EQ(apart.nodes().size(), 2 * first);
  EXPECT_EQ(known.nodes().size(), first);
}

TEST(MapDeformer, MapGoesToItsPinsOnceTheyAreClearlyOff) {
  const Eigen::Vector3d shift(0.4 * kMillimetre, -0.6 * kMillimetre, 0.8 * kMillimetre);
  MapDeformer deformer(options());
  drive(deformer, 0, options().pins_to_bend - 1, shift);
  EXPECT_FALSE(deformer.is_off_pins()) << "so few may be chance";
  drive(deformer, 10, 4, shift);
  ASSERT_TRUE(deformer.is_off_pins());

  const MapDeformation bend = solve(deformer.bend_to_pins(), options().solver);
  ASSERT_TRUE(bend.report.is_accepted()) << bend.report.refusal;
  EXPECT_EQ(bend.kind, DeformationKind::kFrame);
  // A pin is one sigma of 0.15 mm, and there are six: the mean of them is met to half of that.
  constexpr double kMet = 0.08 * kMillimetre;
  SurfelArrays surfels = sheet(0.02, 0.02, {0, 13 * kSecond});
  const SurfelArrays before = surfels;
  bend.graph.apply(surfels);
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    EXPECT_LT((position_of(surfels, k) - position_of(before, k) - shift).norm(), kMet);
  }
  const SE3 motion = deformer.follow(bend);
  EXPECT_LT((motion.translation - shift).norm(), kMet);
  EXPECT_FALSE(deformer.is_off_pins()) << "the keyframes went along";
}

TEST(MapDeformer, PinsThatAreOffByNoMoreThanTheirErrorsBendNothing) {
  MapDeformer small(options());
  drive(small, 0, 10, {0.5 * options().least_shift * kHeight, 0, 0});
  EXPECT_FALSE(small.is_off_pins());

  MapDeformer vague(options());
  constexpr double kVague = 1 * kMillimetre;
  const Eigen::Vector3d shift(2 * kVague, 0, 0);
  for (int k = 0; k < 10; ++k) {
    const SE3 camera = camera_at(kStep * k);
    vague.add(view_at(k * kSecond), camera, false,
              pin_at({camera.rotation, camera.translation + shift}, kVague));
  }
  EXPECT_FALSE(vague.is_off_pins());
}

// The old sheet, and what a keyframe that came back to it makes of it.
LoopMatch match_at(const SE3& map_T_camera, std::int64_t utime, const SurfelArrays& surfels) {
  LoopMatch match;
  match.is_old = match.is_placed = true;
  match.map_T_camera = map_T_camera;
  match.covariance = 1e-12 * Matrix6d::Identity();
  match.keyframe = view_at(utime);
  match.old.grid = kGrid;
  match.old.surfel = Plane<std::int32_t>(kGrid.width, kGrid.height, -1);
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      const Eigen::Vector3d seen =
          map_T_camera *
          (kHeight * Eigen::Vector3d((u - kGrid.cx) / kGrid.fx, (v - kGrid.cy) / kGrid.fy, 1));
      double nearest = kSurfelDistance;
      for (std::size_t k = 0; k < surfels.size(); ++k) {
        const double distance = (position_of(surfels, k).head<2>() - seen.head<2>()).norm();
        if (surfels.updated[k] > 0 || distance >= nearest) continue;
        nearest = distance;
        match.old.surfel.at(u, v) = static_cast<std::int32_t>(k);
      }
    }
  }
  return match;
}

TEST(MapDeformer, LoopClosesOntoTheOldLayer) {
  constexpr int kBack = 100;  // seconds until the second visit
  constexpr double kDrift = 2 * kMillimetre;
  SurfelArrays surfels = sheet(0.04, 0.03, {0, 0});
  const std::size_t old_surfels = surfels.size();
  add_sheet(surfels, 0.04, 0.03, kDrift, TimeSpan::at(kBack * kSecond));

  MapDeformer deformer(options());
  deformer.add(view_at(0), camera_at(0), false, std::nullopt);
  const SE3 drifted{camera_at(0).rotation, {0, 0, kHeight + kDrift}};
  deformer.add(view_at(kBack * kSecond), drifted, false, std::nullopt);

  const LoopMatch match = match_at(camera_at(0), kBack * kSecond, surfels);
  EXPECT_TRUE(deformer.is_displaced(drifted, match));
  EXPECT_FALSE(deformer.is_displaced(camera_at(0), match));
  const MapDeformation bend = solve(deformer.close_loop(drifted, match, surfels), options().solver);
  ASSERT_TRUE(bend.report.is_accepted()) << bend.report.refusal;
  EXPECT_EQ(bend.kind, DeformationKind::kLocalLoop);
  EXPECT_NEAR(bend.report.mean_error_before, kDrift, 0.01 * kMillimetre);

  bend.graph.apply(surfels);
  // Nothing but the loop says where the old layer is: pinned, it stays, and the new one comes to
  // it.
  constexpr double kThin = 0.1 * kMillimetre;
  for (std::size_t k = 0; k < surfels.size(); ++k) {
    EXPECT_NEAR(position_of(surfels, k).z(), 0, kThin) << (k < old_surfels ? "old" : "new");
  }
  EXPECT_NEAR(deformer.follow(bend).translation.z(), -kDrift, kThin);
}

TEST(MapDeformer, WallThatMovesTakesItsPinsAlong) {
  constexpr int kBack = 100;
  constexpr double kMotion = 4 * kMillimetre;
  SurfelArrays surfels = sheet(0.04, 0.03, {0, 0});
  MapDeformer deformer(options());
  drive(deformer, 0, 4, Eigen::Vector3d::Zero());
  deformer.add(view_at(kBack * kSecond), camera_at(0), false, std::nullopt);
  LoopMatch match = match_at(camera_at(0), kBack * kSecond, surfels);
  const double nearer = 1 - kMotion / kHeight;
  for (int v = 5; v < kGrid.height; v += 10) {
    for (int u = 5; u < kGrid.width; u += 10) {
      const Eigen::Vector3d ray((u - kGrid.cx) / kGrid.fx, (v - kGrid.cy) / kGrid.fy, 1);
      match.wall.push_back({static_cast<std::size_t>(v * kGrid.width + u), kHeight * ray,
                            nearer * kHeight * ray, -Eigen::Vector3d::UnitZ()});
    }
  }
  const MapDeformation bend =
      solve(deformer.follow_wall(camera_at(0), match, surfels), options().solver);
  ASSERT_TRUE(bend.report.is_accepted()) << bend.report.refusal;
  EXPECT_TRUE(bend.is_wall);
  bend.graph.apply(surfels);
  double sum = 0;
  for (std::size_t k = 0; k < surfels.size(); ++k) sum += position_of(surfels, k).z();
  // Nearly rigid nodes leave a part of it at the rim, where no patch is.
  EXPECT_NEAR(sum / static_cast<double>(surfels.size()), kMotion, 0.1 * kMotion);
  deformer.follow(bend);
  EXPECT_FALSE(deformer.is_off_pins()) << "the pins would pull the wall back";
}

TEST(MapDeformer, PinsAreThinnedWhereTheyAreDensest) {
  MapDeformerOptions few = options();
  few.most_pins = 5;
  MapDeformer deformer(few);
  const Eigen::Vector3d shift(1 * kMillimetre, 0, 0);
  drive(deformer, 0, 40, shift);
  const DeformationTask task = deformer.bend_to_pins();
  constexpr std::size_t kPointsOfAKeyframe = 6;
  EXPECT_EQ(task.problem.constraints.size(), 5 * kPointsOfAKeyframe);
  // Still from one end to the other.
  double first = std::numeric_limits<double>::infinity();
  double last = -first;
  for (const DeformationConstraint& each : task.problem.constraints) {
    first = std::min(first, each.source.x());
    last = std::max(last, each.source.x());
  }
  EXPECT_GT(last - first, 30 * kStep);
}

TEST(MapDeformer, SimilarityTakesNodesAlongAndPinsOnlyInTheirFrame) {
  MapDeformer deformer(options());
  drive(deformer, 0, 5, {1 * kMillimetre, 0, 0});
  ASSERT_TRUE(deformer.is_off_pins());
  const std::vector<DeformationNode> before = deformer.nodes();
  const Similarity similarity{1.5, so3_exp({0.1, 0.2, 0.3}), {1, 2, 3}};
  MapDeformer in_frame = deformer;
  in_frame.transform(similarity, true);
  EXPECT_TRUE(in_frame.is_off_pins());
  deformer.transform(similarity, false);
  EXPECT_FALSE(deformer.is_off_pins());
  for (std::size_t n = 0; n < before.size(); ++n) {
    EXPECT_EQ(deformer.nodes()[n].position, similarity * before[n].position);
  }
}

TEST(MapDeformer, ImpossibleOptionsAreRefused) {
  MapDeformerOptions wrong = options();
  wrong.spacing = 0;
  EXPECT_THROW(MapDeformer{wrong}, std::invalid_argument);
  wrong = options();
  wrong.pins_to_bend = 0;
  EXPECT_THROW(MapDeformer{wrong}, std::invalid_argument);
  wrong = options();
  wrong.loop_std = 0;
  EXPECT_THROW(MapDeformer{wrong}, std::invalid_argument);
}

}  // namespace
}  // namespace gastronaut::slam

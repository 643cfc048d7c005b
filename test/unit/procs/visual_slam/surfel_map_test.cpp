#include "visual_slam/surfel_map.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>
#include <stdexcept>

#include "deformation_scene.hpp"
#include "numerics/parallel.hpp"
#include "surfel_scene.hpp"
#include "visual_slam/surfel_view.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kDistance = 0.03;  // metres to the wall
const Surface kWall = plane({0, 0, kDistance}, {0, 0, -1});
const Surface kTiltedWall = plane({0, 0, kDistance}, Eigen::Vector3d(0.3, -0.2, -1).normalized());
constexpr double kCavityRadius = 0.03;
const Surface kCavity = sphere({0, 0, 0}, kCavityRadius);
const double kPixel = kDistance / kSceneGrid.fx;  // metres of wall seen by a pixel
constexpr int kBorder = 2;                        // pixels without a full window for normals
// More frames than a corner's surfel needs to become stable at weight exp(-1 / 0.72).
constexpr int kFramesUntilStable = 45;

SurfelMapOptions test_options() {
  SurfelMapOptions options;
  options.working_distance = kDistance;
  options.reserved_surfels = 0;
  return options;
}

FuseReport fuse_seen(SurfelMap& map, const Frame& frame, const SE3& map_T_camera) {
  ModelView view;
  map.predict(map_T_camera, frame.grid, frame.utime, MapPart::kActive, view);
  return map.fuse(frame, view);
}

// Frames from one pose, `first` and on; returns the utime after the last.
std::int64_t watch(SurfelMap& map, const Surface& surface, int frames, std::int64_t first = 0,
                   double relative_std = 0, const SE3& map_T_camera = {}) {
  for (int k = 0; k < frames; ++k, first += kFramePeriod) {
    fuse_seen(map, frame_of(surface, map_T_camera, first, relative_std), map_T_camera);
  }
  return first;
}

ModelView view_of(const SurfelMap& map, const SE3& map_T_camera = {}, std::int64_t now = 0) {
  ModelView view;
  map.predict(map_T_camera, kSceneGrid, now, MapPart::kAll, view);
  return view;
}

// RMS and largest error of depth, metres, and the share of pixels seen, border left out.
struct DepthErrors {
  double rms = 0;
  double most = 0;
  double seen = 0;
};
DepthErrors depth_errors(const ModelView& view, const Surface& surface, int border = kBorder) {
  DepthErrors errors;
  int pixels = 0;
  int seen = 0;
  for (int v = border; v < kSceneGrid.height - border; ++v) {
    for (int u = border; u < kSceneGrid.width - border; ++u, ++pixels) {
      const double depth = static_cast<double>(view.depth.at(u, v));
      if (depth == 0) continue;
      const double error = std::abs(depth - true_depth(surface, view.map_T_camera, u, v));
      errors.rms += error * error;
      errors.most = std::max(errors.most, error);
      ++seen;
    }
  }
  errors.rms = std::sqrt(errors.rms / seen);
  errors.seen = static_cast<double>(seen) / pixels;
  return errors;
}

std::set<std::int32_t> ids_of(const SurfelMap& map) {
  std::set<std::int32_t> ids;
  for (std::size_t k = 0; k < map.surfels().size(); ++k) {
    if (map.surfels().holds(k)) ids.insert(static_cast<std::int32_t>(k));
  }
  return ids;
}

// The same but for the rounding of sums of a dozen floats taken in another order.
void expect_same_view(const ModelView& a, const ModelView& b) {
  constexpr double kRounding = 1e-5;
  const auto expect_near = [&](const Plane<float>& x, const Plane<float>& y) {
    ASSERT_EQ(x.size(), y.size());
    double most = 0;
    for (std::size_t k = 0; k < x.size(); ++k) {
      most = std::max(most, static_cast<double>(std::abs(x.values[k] - y.values[k])));
    }
    EXPECT_LT(most, kRounding);
  };
  expect_near(a.depth, b.depth);
  expect_near(a.normal_x, b.normal_x);
  expect_near(a.normal_y, b.normal_y);
  expect_near(a.normal_z, b.normal_z);
  expect_near(a.albedo, b.albedo);
  EXPECT_EQ(a.confidence.values, b.confidence.values);
  EXPECT_EQ(a.surfel.values, b.surfel.values);
}

TEST(SurfelMap, PlaneIsPredictedExactlyFromWhereverItIsSeen) {
  SurfelMap map(test_options());
  watch(map, kTiltedWall, 1);
  const Eigen::Vector3d normal = Eigen::Vector3d(0.3, -0.2, -1).normalized();
  for (const SE3& map_T_camera :
       {SE3{}, pose({0.001, -0.001, 0.002}, {0.03, -0.02, 0.1}), pose({0, 0, 0.01}, {0, 0, 1})}) {
    const ModelView view = view_of(map, map_T_camera);
    // Discs lie in the plane: what is left is rounding of floats.
    const DepthErrors errors = depth_errors(view, kTiltedWall, 6);
    EXPECT_LT(errors.most, 1e-3 * kPixel);
    EXPECT_EQ(errors.seen, 1);
    const Eigen::Vector3f expected = (map_T_camera.rotation.conjugate() * normal).cast<float>();
    const int u = kSceneGrid.width / 2;
    const int v = kSceneGrid.height / 2;
    const Eigen::Vector3f predicted(view.normal_x.at(u, v), view.normal_y.at(u, v),
                                    view.normal_z.at(u, v));
    EXPECT_LT((predicted - expected).norm(), 1e-3F);
  }
}

TEST(SurfelMap, CavityIsPredictedToTheFlatnessOfADisc) {
  SurfelMap map(test_options());
  const SE3 map_T_camera = pose({0.004, -0.003, 0.002}, {0.1, 0.2, 0.3});
  watch(map, kCavity, 1, 0, 0, map_T_camera);
  const ModelView view = view_of(map, map_T_camera);
  // A disc's rim is off a sphere by radius^2 / (2 R); the largest discs have the double of
  // sqrt(2) pixels, here at most 1.5 times farther than the cavity's radius.
  const double disc = 2 * std::sqrt(2) * 1.5 * kPixel;
  const DepthErrors errors = depth_errors(view, kCavity);
  EXPECT_LT(errors.most, 1.5 * disc * disc / (2 * kCavityRadius));
  EXPECT_EQ(errors.seen, 1);
  for (int v = kBorder; v < kSceneGrid.height - kBorder; ++v) {
    for (int u = kBorder; u < kSceneGrid.width - kBorder; ++u) {
      const double depth = static_cast<double>(view.depth.at(u, v));
      const Eigen::Vector3d point =
          map_T_camera * Eigen::Vector3d(depth * (u - kSceneGrid.cx) / kSceneGrid.fx,
                                         depth * (v - kSceneGrid.cy) / kSceneGrid.fy, depth);
      const Eigen::Vector3d normal =
          map_T_camera.rotation * Eigen::Vector3d(static_cast<double>(view.normal_x.at(u, v)),
                                                  static_cast<double>(view.normal_y.at(u, v)),
                                                  static_cast<double>(view.normal_z.at(u, v)));
      // Normals turn by disc / R from a disc's middle to its rim.
      ASSERT_LT((normal + point.normalized()).norm(), 1.5 * disc / kCavityRadius);
    }
  }
}

TEST(SurfelMap, NoiseFallsWithTheRootOfTheNumberOfFrames) {
  constexpr double kNoise = 0.005;
  constexpr int kFew = 4;
  constexpr int kMany = 64;
  SurfelMap map(test_options());
  const std::int64_t next = watch(map, kWall, kFew, 0, kNoise);
  const double few = depth_errors(view_of(map), kWall).rms;
  watch(map, kWall, kMany - kFew, next, kNoise);
  const double many = depth_errors(view_of(map), kWall).rms;
  EXPECT_LT(many, 2 * kNoise * kDistance / std::sqrt(kMany));
  // sqrt(16) = 4; the nearest of overlapping discs wins, which adds a share that falls as well.
  EXPECT_NEAR(few / many, std::sqrt(kMany / kFew), 1.2);
}

TEST(SurfelMap, NearThingsHideFarOnes) {
  constexpr double kNear = 0.02;
  // A half plane before the wall.
  const Surface step = [](const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
    const double near = (kNear - origin.z()) / direction.z();
    return (origin + near * direction).x() < 0 ? near : kWall(origin, direction);
  };
  SurfelMap map(test_options());
  for (int k = 0; k < 3; ++k) {
    watch(map, step, 1, k * kFramePeriod, 0, pose({0.002 * (k - 1), 0, 0}, {0, 0, 0}));
  }
  const SE3 map_T_camera = pose({0.001, 0, 0}, {0, 0, 0});
  const ModelView view = view_of(map, map_T_camera);
  constexpr int kOutline = 4;  // pixels: discs overhang it, and none are made beside it
  int both_sides = 0;
  for (int v = kBorder; v < kSceneGrid.height - kBorder; ++v) {
    for (int u = 8; u < kSceneGrid.width - 8; ++u) {
      const double depth = true_depth(step, map_T_camera, u, v);
      if (depth != true_depth(step, map_T_camera, u - kOutline, v) ||
          depth != true_depth(step, map_T_camera, u + kOutline, v)) {
        ++both_sides;
        continue;
      }
      ASSERT_NEAR(static_cast<double>(view.depth.at(u, v)), depth, 1e-3 * kPixel) << u << ' ' << v;
    }
  }
  EXPECT_GT(both_sides, 0);
}

TEST(SurfelMap, WallThatMovedAwayIsForgottenAsFreeSpace) {
  constexpr double kFartherWall = 0.036;
  const Surface moved = plane({0, 0, kFartherWall}, {0, 0, -1});
  SurfelMap map(test_options());
  std::int64_t now = watch(map, kWall, kFramesUntilStable);
  int removed = 0;
  for (int k = 0; k < 2 * kFramesUntilStable; ++k, now += kFramePeriod) {
    removed += fuse_seen(map, frame_of(moved, {}, now), {}).removed_free_space;
  }
  EXPECT_GT(removed, 0);
  const DepthErrors errors = depth_errors(view_of(map), moved);
  EXPECT_LT(errors.most, 1e-3 * kPixel);
  EXPECT_EQ(errors.seen, 1);
}

TEST(SurfelMap, WallThatMovedCloserHidesTheOldOne) {
  const Surface moved = plane({0, 0, 0.02}, {0, 0, -1});
  SurfelMap map(test_options());
  const std::int64_t now = watch(map, kWall, kFramesUntilStable);
  watch(map, moved, 2, now);
  EXPECT_LT(depth_errors(view_of(map), moved).most, 1e-3 * kPixel);
}

TEST(SurfelMap, WallMeasuredTooNearNowAndThenMakesNoPileOfSurfels) {
  // Beyond the gate, as highlights do; what is seen afterwards pulls the new layer to the wall.
  const Surface near = plane({0, 0, 0.96 * kDistance}, {0, 0, -1});
  constexpr int kRounds = 40;
  constexpr int kFramesBetween = 10;
  SurfelMap map(test_options());
  std::int64_t now = watch(map, kWall, kFramesUntilStable);
  for (int round = 0; round < kRounds; ++round) {
    now = watch(map, near, 1, now);
    now = watch(map, kWall, kFramesBetween, now);
  }
  constexpr int kLayers = 2;
  EXPECT_LT(map.size(), kLayers * kSceneGrid.width * kSceneGrid.height);
  EXPECT_EQ(depth_errors(view_of(map), kWall).seen, 1);
}

TEST(SurfelMap, SurfelsOnTopOfEachOtherBecomeOne) {
  SurfelMap map(test_options());
  std::int64_t now = watch(map, kWall, kFramesUntilStable);
  const SurfelArrays once = map.surfels();
  const int size = map.size();
  map.add(once);
  EXPECT_EQ(map.size(), 2 * size);
  const FuseReport report = fuse_seen(map, frame_of(kWall, {}, now), {});
  EXPECT_EQ(report.merged, size);
  EXPECT_EQ(map.size(), size);
  const SurfelArrays& merged = map.surfels();
  for (std::size_t k = 0; k < merged.size(); ++k) {
    if (!merged.holds(k)) continue;
    EXPECT_GT(merged.confidence[k], 2 * once.confidence[k % once.size()]);
  }
  // Neighbours of one picture are not on top of each other, however flat they are seen.
  for (const double tilt : {0.0, 0.8, 1.2}) {  // radians
    SurfelMap tilted(test_options());
    const Surface wall = plane({0, 0, kDistance}, {std::sin(tilt), 0, -std::cos(tilt)});
    for (int k = 0; k < 5; ++k) {
      EXPECT_EQ(fuse_seen(tilted, frame_of(wall, {}, k * kFramePeriod), {}).merged, 0) << tilt;
    }
  }
}

TEST(SurfelMap, UnstableSurfelsVanishUnseenAndStableOnesStay) {
  const SurfelMapOptions options = test_options();
  const Surface nothing = [](const Eigen::Vector3d&, const Eigen::Vector3d&) { return 0.0; };
  const int unseen = static_cast<int>(std::ceil(options.unseen_limit * kFrameRate)) + 2;
  SurfelMap brief(options);
  const std::int64_t next = watch(brief, kWall, 1);
  EXPECT_GT(brief.size(), 0);
  watch(brief, nothing, unseen / 2, next);
  EXPECT_GT(brief.size(), 0);
  watch(brief, nothing, unseen, next + unseen / 2 * kFramePeriod);
  EXPECT_EQ(brief.size(), 0);

  SurfelMap lasting(options);
  const std::int64_t end = watch(lasting, kWall, kFramesUntilStable);
  watch(lasting, nothing, 10 * unseen, end);
  EXPECT_EQ(depth_errors(view_of(lasting), kWall).seen, 1);
  for (const std::int32_t id : ids_of(lasting)) ASSERT_TRUE(lasting.is_stable(id));
}

TEST(SurfelMap, UpdateIsTheMeanWeightedByConfidence) {
  SurfelMap map(test_options());
  const double nearer = 0.99 * kDistance;
  watch(map, kWall, 3);
  const int u = kSceneGrid.width / 2;
  const int v = kSceneGrid.height / 2;
  const auto id = static_cast<std::size_t>(view_of(map).surfel.at(u, v));
  const double before = static_cast<double>(map.surfels().confidence[id]);
  const std::int64_t later = 3 * kFramePeriod;
  watch(map, plane({0, 0, nearer}, {0, 0, -1}), 1, later);
  const double weight = static_cast<double>(map.surfels().confidence[id]) - before;
  // Half a pixel from the middle, exp(-(d / d_max)^2 / 0.72) is 1 up to 0.001.
  EXPECT_NEAR(weight, 1, 1e-3);
  EXPECT_NEAR(static_cast<double>(map.surfels().z[id]),
              (before * kDistance + weight * nearer) / (before + weight), 1e-3 * kPixel);
  EXPECT_EQ(map.surfels().initialised[id], 0);
  EXPECT_EQ(map.surfels().updated[id], later);
}

TEST(SurfelMap, CoarseViewsConfirmFineSurfelsWithoutMovingThem) {
  SurfelMap map(test_options());
  watch(map, kWall, 3);
  const SurfelArrays fine = map.surfels();
  const SE3 far = pose({0, 0, -kDistance}, {0, 0, 0});  // discs twice as large
  const Surface offset = plane({0, 0, 1.01 * kDistance}, {0, 0, -1});
  EXPECT_GT(fuse_seen(map, frame_of(offset, far, 3 * kFramePeriod), far).associated, 0);
  const SurfelArrays& now = map.surfels();
  for (std::size_t k = 0; k < fine.size(); ++k) {
    if (!fine.holds(k) || now.updated[k] != 3 * kFramePeriod) continue;
    ASSERT_EQ(now.z[k], fine.z[k]);
    ASSERT_GT(now.confidence[k], fine.confidence[k]);
  }
}

TEST(SurfelMap, UncertainFramesWeighLess) {
  SurfelMapOptions options = test_options();
  const auto confidence = [&](double relative_std) {
    SurfelMap map(options);
    Frame frame = frame_of(kWall, {}, 0);
    frame.relative_std = relative_std;
    fuse_seen(map, frame, {});
    return static_cast<double>(
        view_of(map).confidence.at(kSceneGrid.width / 2, kSceneGrid.height / 2));
  };
  constexpr double kRounding = 1e-6;
  EXPECT_NEAR(confidence(3 * options.trusted_relative_std),
              confidence(options.trusted_relative_std) / 9, kRounding);
}

TEST(SurfelMap, IncrementsRebuildTheMapAndIdsAreNotReusedBeforeTheyAreTaken) {
  SurfelMap map(test_options());
  SurfelArrays copy;
  std::int64_t now = 0;
  int reused = 0;
  for (int round = 0; round < 6; ++round) {
    const std::set<std::int32_t> before = ids_of(map);
    const std::size_t capacity = map.surfels().size();
    // The wall comes and goes far enough for surfels to be seen through.
    now = watch(map, round % 2 == 0 ? kTiltedWall : plane({0, 0, 0.04}, {0, 0, -1}), 8, now, 0.002);
    const SurfelArrays& surfels = map.surfels();
    const MapIncrement increment = map.take_increment();
    for (const std::int32_t id : increment.removed) {
      // Nobody else has it yet.
      ASSERT_FALSE(surfels.holds(static_cast<std::size_t>(id)));
    }
    for (const std::int32_t id : ids_of(map)) {
      reused += before.count(id) == 0 && static_cast<std::size_t>(id) < capacity;
    }
    copy.resize(surfels.size());
    for (const std::int32_t id : increment.removed) {
      SurfelArrays::for_each_array(copy,
                                   [id](auto& array) { array[static_cast<std::size_t>(id)] = {}; });
    }
    for (const std::int32_t id : increment.changed) {
      const auto k = static_cast<std::size_t>(id);
      copy.x[k] = surfels.x[k];
      copy.y[k] = surfels.y[k];
      copy.z[k] = surfels.z[k];
      copy.nx[k] = surfels.nx[k];
      copy.ny[k] = surfels.ny[k];
      copy.nz[k] = surfels.nz[k];
      copy.albedo[k] = surfels.albedo[k];
      copy.confidence[k] = surfels.confidence[k];
      copy.radius[k] = surfels.radius[k];
      copy.initialised[k] = surfels.initialised[k];
      copy.updated[k] = surfels.updated[k];
    }
    ASSERT_EQ(copy, surfels);
  }
  EXPECT_GT(reused, 0);
  EXPECT_TRUE(map.take_increment().changed.empty());
}

TEST(SurfelMap, SurfelsNotSeenForTheWindowAreInactive) {
  const SurfelMapOptions options = test_options();
  SurfelMap map(options);
  const std::int64_t last = watch(map, kWall, kFramesUntilStable) - kFramePeriod;
  const auto window = static_cast<std::int64_t>(options.active_window * 1e6);
  ModelView view;
  map.predict({}, kSceneGrid, window, MapPart::kActive, view);
  expect_same_view(view, view_of(map));
  map.predict({}, kSceneGrid, last + window + 1, MapPart::kActive, view);
  EXPECT_THAT(view.surfel.values, testing::Each(-1));
  const std::int32_t id = *ids_of(map).begin();
  EXPECT_FALSE(map.is_active(id, last + 2 * window));
}

TEST(SurfelMap, CullingChangesNothing) {
  SurfelMap map(test_options());
  for (int k = 0; k < 12; ++k) {
    watch(map, kCavity, 1, k * kFramePeriod, 0.002, pose({0, 0, 0}, {0, 0.5 * k, 0.2 * k}));
  }
  std::vector<std::int32_t> all;
  for (const std::int32_t id : ids_of(map)) all.push_back(id);
  const SurfelMapOptions options = test_options();
  SplatOptions splat_options;
  splat_options.farthest = options.farthest * options.working_distance;
  splat_options.minimum_cosine = options.minimum_cosine;
  for (int k = 0; k < 20; ++k) {
    const SE3 map_T_camera = pose({0.001 * k, 0.0005 * k, -0.0008 * k}, {0.4 * k, 0.3, -0.2 * k});
    ModelView whole;
    whole.map_T_camera = map_T_camera;
    whole.grid = kSceneGrid;
    splat(map.surfels(), {all}, splat_options, whole);
    expect_same_view(view_of(map, map_T_camera), whole);
  }
}

TEST(SurfelMap, ThreadsChangeNothing) {
  const auto run = [](int threads, ModelView& view) {
    set_thread_count(threads);
    SurfelMap map(test_options());
    for (int k = 0; k < 30; ++k) {
      watch(map, k < 15 ? kCavity : sphere({0, 0, 0.003}, kCavityRadius), 1, k * kFramePeriod,
            0.004, pose({0, 0, 0.0001 * k}, {0, 0.02 * k, 0}));
    }
    view = view_of(map);
    set_thread_count(0);
    return map.surfels();
  };
  ModelView one_view;
  ModelView four_view;
  EXPECT_EQ(run(1, one_view), run(4, four_view));
  expect_same_view(one_view, four_view);
}

TEST(SurfelMap, FramesWithoutUsableDepthChangeNothing) {
  SurfelMap map(test_options());
  std::int64_t now = watch(map, kWall, kFramesUntilStable);
  const SurfelArrays before = map.surfels();
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  for (const float depth : {0.0F, std::numeric_limits<float>::quiet_NaN(), kInfinity, -kInfinity,
                            -0.03F, 1e-30F, 1e30F, std::numeric_limits<float>::max()}) {
    Frame frame = frame_of(kWall, {}, now);
    std::fill(frame.depth.values.begin(), frame.depth.values.end(), depth);
    SurfelMap empty(test_options());
    fuse_seen(empty, frame, {});
    for (const std::int32_t id : ids_of(empty)) {
      EXPECT_TRUE(std::isfinite(empty.surfels().nz[static_cast<std::size_t>(id)])) << depth;
    }
    if (depth == 1e-30F) continue;  // a depth like any other, if a small one
    EXPECT_EQ(empty.size(), 0) << depth;
    fuse_seen(map, frame, {});
    EXPECT_EQ(map.surfels(), before) << depth;
  }
}

TEST(SurfelMap, FramesOfAnotherGridAreRefused) {
  SurfelMap map(test_options());
  const Frame frame = frame_of(kWall, {}, 0);
  ModelView view;
  EXPECT_THROW(map.fuse(frame, view), std::invalid_argument);
  map.predict({}, kSceneGrid.coarser(2), 0, MapPart::kAll, view);
  EXPECT_THROW(map.fuse(frame, view), std::invalid_argument);
  map.predict({}, kSceneGrid, 0, MapPart::kAll, view);
  EXPECT_THROW(map.fuse(Frame{0, kSceneGrid, {}, {}, 0}, view), std::invalid_argument);
}

TEST(SurfelMap, MapOfKeptSurfelsLooksAsBeforeAndGoesOn) {
  SurfelMap map(test_options());
  const std::int64_t now = watch(map, kCavity, kFramesUntilStable, 0, 0.002);
  SurfelMap again(test_options(), map.surfels());
  EXPECT_EQ(again.size(), map.size());
  expect_same_view(view_of(again), view_of(map));
  const Frame frame = frame_of(kCavity, {}, now, 0.002);
  EXPECT_EQ(fuse_seen(again, frame, {}).associated, fuse_seen(map, frame, {}).associated);
}

TEST(SurfelMap, SurfelsOutOfReachAndSenselessOptionsAreRefused) {
  SurfelArrays surfels;
  surfels.resize(1);
  surfels.radius[0] = 1;
  surfels.x[0] = 1e30F;
  EXPECT_THROW(SurfelMap(test_options(), surfels), std::invalid_argument);
  SurfelMapOptions options;
  options.working_distance = 0;
  EXPECT_THROW(SurfelMap{options}, std::invalid_argument);
}

TEST(SurfelMap, RoomOfMetresBehavesAsACavityOfMillimetres) {
  // A power of two scales floats without rounding.
  constexpr double kScale = 64;
  SurfelMap small(test_options());
  SurfelMapOptions options = test_options();
  options.working_distance *= kScale;
  SurfelMap large(options);
  for (int k = 0; k < 10; ++k) {
    const SE3 map_T_camera = pose({0.0005 * k, 0, 0}, {0, 0.01 * k, 0});
    SE3 far = map_T_camera;
    far.translation *= kScale;
    const Frame frame = frame_of(kCavity, map_T_camera, k * kFramePeriod, 0.003);
    Frame scaled = frame;
    for (float& depth : scaled.depth.values) depth *= static_cast<float>(kScale);
    const FuseReport one = fuse_seen(small, frame, map_T_camera);
    const FuseReport other = fuse_seen(large, scaled, far);
    ASSERT_EQ(one.associated, other.associated);
    ASSERT_EQ(one.created, other.created);
  }
}

TEST(SurfelMap, LooksTheSameInAnotherFrameAndOtherMetres) {
  const Similarity similarity{1.1, so3_exp({0.5, -1, 2}), {0.1, 0.2, -0.3}};
  SurfelMap map(test_options());
  watch(map, kTiltedWall, 3);
  const ModelView before = view_of(map);
  map.take_increment();
  map.transform(similarity);
  const ModelView after = view_of(map, similarity * SE3{});
  EXPECT_EQ(map.take_increment().changed.size(), static_cast<std::size_t>(map.size()));
  constexpr double kRounding = 1e-4;  // of surfels a tenth of a metre off, as floats
  double most = 0;
  std::size_t seen = 0;
  for (std::size_t k = 0; k < before.depth.size(); ++k) {
    if (!(before.depth.values[k] > 0 && after.depth.values[k] > 0)) continue;
    ++seen;
    const double expected = similarity.scale * static_cast<double>(before.depth.values[k]);
    most = std::max(
        {most, std::abs(static_cast<double>(after.depth.values[k]) / expected - 1),
         std::abs(static_cast<double>(after.normal_z.values[k] - before.normal_z.values[k]))});
  }
  EXPECT_GT(seen, before.depth.size() * 9 / 10);
  EXPECT_LT(most, kRounding);
  // And goes on from there.
  Frame frame = frame_of(kTiltedWall, {}, 3 * kFramePeriod);
  for (float& depth : frame.depth.values) depth *= static_cast<float>(similarity.scale);
  const int size = map.size();
  const FuseReport report = fuse_seen(map, frame, similarity * SE3{});
  EXPECT_GT(report.associated, size / 2);
  EXPECT_LT(map.size(), 1.1 * size);
}

constexpr double kShadingStd = 0.03;  // of a depth that is wrong smoothly

// A wall that has come nearer, or gone farther, while nobody looked: the old one must not show.
TEST(SurfelMap, GivesWayToAFrameThatIsRight) {
  for (const double moved : {0.86, 1.14}) {
    SCOPED_TRACE(moved);
    const Surface now = plane({0, 0, moved * kDistance}, {0, 0, -1});
    SurfelMap map(test_options());
    std::int64_t utime = watch(map, kWall, kFramesUntilStable);
    Frame frame = frame_of(now, {}, utime);
    frame.relative_std = kShadingStd;
    map.give_way(frame, {});
    fuse_seen(map, frame, {});
    EXPECT_LT(depth_errors(view_of(map), now).most, 0.2 * kDistance * std::abs(1 - moved));
    for (const std::int32_t id : ids_of(map)) {
      EXPECT_LE(static_cast<double>(map.surfels().confidence[static_cast<std::size_t>(id)]),
                test_options().stable_confidence);
    }
  }
}

TEST(SurfelMap, WhatTheFrameDoesNotContradictStays) {
  SurfelMap map(test_options());
  std::int64_t utime = watch(map, kWall, kFramesUntilStable);
  const auto before = ids_of(map);
  Frame frame = frame_of(kWall, {}, utime);
  frame.relative_std = kShadingStd;
  for (int v = 0; v < kSceneGrid.height; ++v) frame.depth.at(7, v) = 0;  // nothing measured
  map.give_way(frame, {});
  EXPECT_EQ(ids_of(map), before);
}

TEST(SurfelMap, FollowsTheGraphEverywhere) {
  const SurfelArrays sheets = sheet(60 * kMillimetre, 40 * kMillimetre);
  DeformationGraph graph = DeformationGraph::sample(sheets, graph_options());
  Eigen::Vector3d shift(0.2 * kMillimetre, 0, kMillimetre);
  for (std::size_t n = 0; n < graph.nodes().size(); n += graph.nodes().size() / 3) {
    graph.set_motion(n, so3_exp({0.05, 0, 0.02}).toRotationMatrix(), shift);
    shift = -shift;
  }
  SurfelArrays expected = sheets;
  std::vector<std::int32_t> all(sheets.size());
  std::iota(all.begin(), all.end(), 0);
  ASSERT_FALSE(graph.apply(expected, all).empty());
  SurfelMap map(test_options(), sheets);
  map.take_increment();
  map.deform(graph);
  EXPECT_EQ(map.surfels(), expected);
  for (const std::int32_t id : map.take_increment().changed) {
    EXPECT_NE(position_of(sheets, static_cast<std::size_t>(id)),
              position_of(expected, static_cast<std::size_t>(id)));
  }
}

TEST(SurfelMap, OldPartIsWhatWasMadeBeforeTheWindow) {
  SurfelMap map(test_options());
  watch(map, kWall, kFramesUntilStable);
  const auto later = static_cast<std::int64_t>(2e6 * test_options().active_window);
  const SE3 aside{Eigen::Quaterniond::Identity(), {kDistance, 0, 0}};
  watch(map, kWall, kFramesUntilStable, later, 0, aside);
  ModelView old;
  map.predict(aside, kSceneGrid, later, MapPart::kOld, old);
  const ModelView all = view_of(map, aside, later);
  int shown = 0;
  for (std::size_t k = 0; k < old.surfel.size(); ++k) {
    EXPECT_GE(all.surfel.values[k], 0);
    const std::int32_t id = old.surfel.values[k];
    if (id < 0) continue;
    ++shown;
    EXPECT_LT(map.surfels().initialised[static_cast<std::size_t>(id)], map.old_before(later));
  }
  EXPECT_GT(shown, 0);
  EXPECT_LT(shown, static_cast<int>(old.surfel.size()));
}

TEST(SurfelMap, SurfelsOfAnotherMapGetIdsOfThisOne) {
  SurfelMap here(test_options());
  watch(here, kWall, 3);
  SurfelMap there(test_options());
  const SE3 beside = pose({0.2, 0, 0}, {0, 0, 0});
  watch(there, kWall, 3, 0, 0, beside);
  const int size = here.size();
  const ModelView before = view_of(here);
  here.take_increment();
  here.add(there.surfels());
  EXPECT_EQ(here.size(), size + there.size());
  EXPECT_EQ(ids_of(here).size(), static_cast<std::size_t>(here.size()));
  EXPECT_EQ(here.take_increment().changed.size(), static_cast<std::size_t>(there.size()));
  expect_same_view(view_of(here), before);
  EXPECT_EQ(view_of(here, beside).depth.values, view_of(there, beside).depth.values);
}

}  // namespace
}  // namespace gastronaut::slam

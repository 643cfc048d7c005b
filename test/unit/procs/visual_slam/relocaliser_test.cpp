#include "visual_slam/relocaliser.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>

#include "unit/procs/visual_slam/surfel_scene.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kDegree = M_PI / 180;
// What the tracker can start from.
constexpr double kBasinMetres = 5e-3;
constexpr double kBasinRadians = 8 * kDegree;

const Surface kWall = plane({0, 0, 0.03}, Eigen::Vector3d(0.3, 0.2, -1).normalized());

// Blotches of 6 to 20 mm, nowhere the same.
double blotches(const Eigen::Vector3d& p) {
  return 0.5 + 0.1 * std::sin(310 * p.x() + 170 * p.y()) +
         0.1 * std::sin(430 * p.y() - 90 * p.x()) +
         0.1 * std::sin(200 * p.x() * (1 + 20 * p.y()) + 1);
}

Frame look(const SE3& map_T_camera) {
  Frame frame = frame_of(kWall, map_T_camera, 0);
  for (int v = 0; v < kSceneGrid.height; ++v) {
    for (int u = 0; u < kSceneGrid.width; ++u) {
      const Eigen::Vector3d ray((u - kSceneGrid.cx) / kSceneGrid.fx,
                                (v - kSceneGrid.cy) / kSceneGrid.fy, 1);
      const Eigen::Vector3d point = static_cast<double>(frame.depth.at(u, v)) * ray;
      frame.albedo.at(u, v) = static_cast<float>(blotches(map_T_camera * point));
    }
  }
  return frame;
}

// Five by five places, 8 mm apart.
Relocaliser filled() {
  constexpr double kApart = 8e-3;
  Relocaliser relocaliser(kSceneGrid, {});
  for (int j = -2; j <= 2; ++j) {
    for (int i = -2; i <= 2; ++i) {
      const SE3 camera = pose({i * kApart, j * kApart, 0}, {0, 0, 0});
      EXPECT_TRUE(relocaliser.add(look(camera), camera));
    }
  }
  return relocaliser;
}

TEST(Relocaliser, ProposesThePoseItself) {
  const Relocaliser relocaliser = filled();
  const SE3 truth = pose({8e-3, -16e-3, 0}, {0, 0, 0});  // a stored one
  const auto found = relocaliser.candidates(look(truth), 1);
  ASSERT_EQ(found.size(), 1U);
  constexpr double kRounding = 1e-6;  // depths are floats
  EXPECT_LT((found[0].translation - truth.translation).norm(), kRounding);
}

TEST(Relocaliser, CorrectsForShiftAdvanceAndTurn) {
  const Relocaliser relocaliser = filled();
  for (const SE3& truth : {pose({3e-3, 4e-3, 0}, {0, 0, 15 * kDegree}),
                           pose({-5e-3, 2e-3, 3e-3}, {0, 0, -20 * kDegree}),
                           pose({-4e-3, -4e-3, -2e-3}, {8 * kDegree, -6 * kDegree, 0})}) {
    const auto found = relocaliser.candidates(look(truth), 1);
    ASSERT_EQ(found.size(), 1U);
    EXPECT_LT((found[0].translation - truth.translation).norm(), kBasinMetres);
    EXPECT_LT(angle_between(found[0].rotation, truth.rotation), kBasinRadians);
  }
}

TEST(Relocaliser, StoresOnlyWhatIsNew) {
  Relocaliser relocaliser(kSceneGrid, {});
  EXPECT_TRUE(relocaliser.add(look({}), {}));
  const SE3 near = pose({1e-3, 0, 0}, {0, 0, 0});
  EXPECT_FALSE(relocaliser.add(look(near), near));
  const SE3 turned = pose({0, 0, 0}, {0, 0, 20 * kDegree});
  EXPECT_TRUE(relocaliser.add(look(turned), turned));
  EXPECT_EQ(relocaliser.size(), 2);
}

TEST(Relocaliser, KeepsNoMoreThanItMay) {
  RelocaliserOptions options;
  options.most = 3;
  Relocaliser relocaliser(kSceneGrid, options);
  SE3 camera;
  for (int k = 0; k < 6; ++k) {
    camera.translation.x() = 8e-3 * k;
    EXPECT_TRUE(relocaliser.add(look(camera), camera));
  }
  EXPECT_EQ(relocaliser.size(), options.most);
  EXPECT_FALSE(relocaliser.candidates(look(camera), 1).empty());
}

TEST(Relocaliser, FramesWithNothingInThemAreNeitherStoredNorMatched) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  Relocaliser relocaliser = filled();
  const int size = relocaliser.size();
  for (const float none : {0.0F, kNan}) {
    Frame frame = look({});
    for (float& depth : frame.depth.values) depth = none;
    EXPECT_FALSE(relocaliser.add(frame, pose({1, 0, 0}, {0, 0, 0})));
    EXPECT_TRUE(relocaliser.candidates(frame, 5).empty());
  }
  Frame dark = look({});
  for (float& albedo : dark.albedo.values) albedo = -1;
  EXPECT_TRUE(relocaliser.candidates(dark, 5).empty());
  EXPECT_EQ(relocaliser.size(), size);
}

TEST(Relocaliser, NothingStoredNothingProposed) {
  EXPECT_TRUE(Relocaliser(kSceneGrid, {}).candidates(look({}), 5).empty());
}

TEST(Relocaliser, RefusesAnotherGrid) {
  Frame frame = look({});
  frame.grid.fx += 1;
  EXPECT_THROW(filled().candidates(frame, 1), std::invalid_argument);
}

TEST(Relocaliser, ProposesTheSamePlaceInAnotherFrameAndOtherMetres) {
  Relocaliser relocaliser = filled();
  Frame seen = look(pose({3e-3, 4e-3, 0}, {0, 0, 15 * kDegree}));
  const auto before = relocaliser.candidates(seen, 1);
  const Similarity similarity{1.1, so3_exp({0.5, -1, 2}), {0.1, 0.2, -0.3}};
  relocaliser.transform(similarity);
  for (float& depth : seen.depth.values) depth *= static_cast<float>(similarity.scale);
  const auto after = relocaliser.candidates(seen, 1);
  ASSERT_EQ(before.size(), 1U);
  ASSERT_EQ(after.size(), 1U);
  constexpr double kRounding = 1e-6;  // depths are floats
  const SE3 expected = similarity * before[0];
  EXPECT_LT((after[0].translation - expected.translation).norm(), kRounding);
  EXPECT_LT(angle_between(after[0].rotation, expected.rotation), kRounding / kBasinMetres);
}

}  // namespace
}  // namespace gastronaut::slam

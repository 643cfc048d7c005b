#include "visual_slam/loop_search.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "unit/procs/visual_slam/slam_scene.hpp"

namespace gastronaut::slam {
namespace {

using ::testing::HasSubstr;

constexpr double kStd = 0.005;  // of depth
constexpr int kVisit = 40;      // frames of the first visit
// The next visit: everything is old by then.
constexpr std::int64_t kLater = kStart + 60'000'000;
// Where the camera is thought to be when it comes back: 2 mm and 3 degrees off.
const SE3 kDrift{so3_exp({0.02, -0.04, 0.02}), {1.5e-3, 1e-3, -1e-3}};

class LoopSearchTest : public ::testing::Test {
 protected:
  LoopSearchTest() : map_(map_options()), places_(kCameraGrid, {}) {
    ModelView view;
    for (int k = 0; k < kVisit; ++k) {
      const Frame frame = look(camera_at(k), utime_of(k), kStd);
      map_.predict(camera_at(k), frame.grid, frame.utime, MapPart::kAll, view);
      map_.fuse(frame, view);
      places_.add(frame, camera_at(k));
    }
  }
  static SurfelMapOptions map_options() {
    SurfelMapOptions options;
    options.working_distance = kWallDistance;
    return options;
  }
  LoopMatch look_back(const SE3& truth, const SE3& believed, std::int64_t utime = kLater,
                      const std::optional<PlaceGate>& gate = std::nullopt) {
    LoopSearch search(kCameraGrid, {}, {});
    return search.look(look(truth, utime, kStd), believed, map_, places_, gate);
  }

  SurfelMap map_;
  Relocaliser places_;
};

TEST_F(LoopSearchTest, CameraThatComesBackIsFoundWhereItIs) {
  for (const int k : {5, 17, 31}) {
    const SE3 truth = camera_at(k);
    const LoopMatch match = look_back(truth, truth * kDrift);
    ASSERT_TRUE(match.is_accepted()) << match.refusal;
    EXPECT_FALSE(match.is_global);
    EXPECT_TRUE(match.wall.empty());
    const PoseError error = error_of(match.map_T_camera, truth);
    EXPECT_LT(error.metres, kPixelMetres);
    EXPECT_LT(error.radians, kPixelRadians);
    EXPECT_TRUE(is_covariance(match.covariance));
  }
}

TEST_F(LoopSearchTest, WhatWasSeenJustNowIsNotOld) {
  const LoopMatch match = look_back(camera_at(kVisit), camera_at(kVisit), utime_of(kVisit));
  EXPECT_FALSE(match.is_old);
  EXPECT_FALSE(match.is_accepted());
}

TEST_F(LoopSearchTest, FarFromWhereItIsThoughtToBeItIsFoundByItsLooks) {
  const SE3 far{Eigen::Quaterniond::Identity(), {0.5, 0, 0}};  // nothing of the map in view
  const LoopMatch match = look_back(camera_at(17), far * camera_at(17));
  ASSERT_TRUE(match.is_accepted()) << match.refusal;
  EXPECT_TRUE(match.is_global);
  EXPECT_LT(error_of(match.map_T_camera, camera_at(17)).metres, kPixelMetres);
}

TEST_F(LoopSearchTest, OtherTissueIsNoLoop) {
  // 60 mm beside all that was seen; believed to be where the map is.
  const SE3 elsewhere{Eigen::Quaterniond::Identity(), {0.06, 0, 0}};
  for (const int k : {5, 17, 31}) {
    const LoopMatch match = look_back(elsewhere * camera_at(k), camera_at(k));
    EXPECT_FALSE(match.is_accepted());
    EXPECT_FALSE(match.refusal.empty());
  }
}

TEST_F(LoopSearchTest, MagnetForbidsWhatLooksRight) {
  const SE3 truth = camera_at(17);
  constexpr double kRadius = 5e-3;
  const Eigen::Vector3d aside(2 * kRadius, 0, 0);
  const PlaceGate wrong{truth.translation + aside, kRadius};
  const LoopMatch match = look_back(truth, truth * kDrift, kLater, wrong);
  EXPECT_FALSE(match.is_accepted());
  EXPECT_THAT(match.refusal, HasSubstr("magnet"));
  EXPECT_TRUE(look_back(truth, truth * kDrift, kLater, PlaceGate{truth.translation, kRadius})
                  .is_accepted());
}

TEST_F(LoopSearchTest, WallThatHasMovedIsPlacedAndSaid) {
  const SE3 truth = camera_at(17);
  Frame keyframe = look(truth, kLater, 0);
  keyframe.relative_std = 0.03;
  constexpr double kNearer = 0.8;
  for (int v = 0; v < keyframe.grid.height; ++v) {
    for (int u = 0; u < keyframe.grid.width / 5; ++u) {
      keyframe.depth.at(u, v) *= static_cast<float>(kNearer);
    }
  }
  LoopSearch search(kCameraGrid, {}, {});
  const LoopMatch match = search.look(keyframe, truth, map_, places_, std::nullopt);
  ASSERT_TRUE(match.is_placed) << match.refusal;
  EXPECT_FALSE(match.wall.empty());
}

}  // namespace
}  // namespace gastronaut::slam

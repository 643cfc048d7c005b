#include "visual_slam/visual_slam.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <functional>
#include <limits>
#include <optional>
#include <stdexcept>
#include <thread>
#include <vector>

#include "numerics/parallel.hpp"
#include "unit/procs/visual_slam/slam_scene.hpp"

namespace gastronaut::slam {
namespace {

using ::testing::HasSubstr;

// A sensor's depth, merged frame by frame; and that of shading, merged by refined keyframes.
constexpr double kCertain = 0.002;
constexpr double kUncertain = 0.03;
constexpr double kAlbedoStd = 0.01;  // of a camera's noise
// Off the line to any place the map knows: a camera pulled on by its tether.
const SE3 kElsewhere{Eigen::Quaterniond::Identity(), {0.05, 0, 0}};

VisualSlamOptions options() {
  VisualSlamOptions options;
  options.map.working_distance = kWallDistance;
  options.map.stable_confidence = 3;
  return options;
}

Frame frame_at(const SE3& map_T_camera, int number, double relative_std = kCertain) {
  return look(map_T_camera, utime_of(number), relative_std, kAlbedoStd);
}

bool is_finite(const SurfelArrays& surfels) {
  bool finite = true;
  SurfelArrays::for_each_array(surfels, [&](const auto& array) {
    for (const auto value : array) finite = finite && std::isfinite(static_cast<double>(value));
  });
  return finite;
}

// Frames in, poses out; what holds for every pose is asked each time.
struct Session {
  explicit Session(double std = kCertain, const VisualSlamOptions& chosen = options())
      : relative_std(std), slam(chosen) {}
  Session(double std, KeptMap kept) : relative_std(std), slam(options(), std::move(kept)) {}

  SlamPose see(const Frame& frame, const PictureHealth& health = {},
               const std::optional<FusedState>& fused = std::nullopt) {
    const SlamPose pose = slam.track(frame, health);
    slam.merge(fused);
    check(pose, frame.utime);
    return pose;
  }
  SlamPose see(int number) { return see(frame_at(camera_at(number), number, relative_std)); }
  void follow(int begin, int end) {
    for (int number = begin; number < end; ++number) see(number);
  }
  void check(const SlamPose& pose, std::int64_t utime) const {
    EXPECT_EQ(pose.utime, utime);
    EXPECT_TRUE(pose.map_T_camera.matrix().allFinite());
    EXPECT_TRUE(is_covariance(pose.covariance)) << pose.covariance;
    EXPECT_TRUE(std::isfinite(pose.icp_rms) && std::isfinite(pose.rgb_rms) &&
                std::isfinite(pose.inlier_fraction) && std::isfinite(pose.depth_scale));
    // Said so, and why.
    if (pose.status == SlamStatus::kRelocalised) return;
    EXPECT_EQ(pose.status == SlamStatus::kOk, pose.cause.empty()) << pose.cause;
  }

  double relative_std;
  VisualSlam slam;
};

// To a pixel; and no better than the depth that the map began with.
void expect_at(const SlamPose& pose, const SE3& truth, double relative_std = kCertain) {
  const PoseError error = error_of(pose.map_T_camera, truth);
  EXPECT_LT(error.metres, std::max(kPixelMetres, relative_std * kWallDistance));
  EXPECT_LT(error.radians, std::max(kPixelRadians, relative_std));
}

class VisualSlamOnDepth : public ::testing::TestWithParam<double> {};
INSTANTIATE_TEST_SUITE_P(CertainAndUncertain, VisualSlamOnDepth,
                         ::testing::Values(kCertain, kUncertain), [](const auto& tested) {
                           return tested.param == kCertain ? "Certain" : "Uncertain";
                         });

TEST_P(VisualSlamOnDepth, FollowsTheCamera) {
  Session run(GetParam());
  for (int k = 0; k < 60; ++k) {
    SCOPED_TRACE(k);
    const SlamPose pose = run.see(k);
    EXPECT_EQ(pose.status, SlamStatus::kOk);
    expect_at(pose, camera_at(k), GetParam());
  }
  EXPECT_TRUE(is_finite(run.slam.map().surfels()));
}

TEST_P(VisualSlamOnDepth, GoesOnAfterFramesThatAreMissing) {
  Session run(GetParam());
  run.follow(0, 20);
  for (const int k : {23, 24, 34, 35}) {
    SCOPED_TRACE(k);
    const SlamPose pose = run.see(k);
    EXPECT_NE(pose.status, SlamStatus::kLost) << pose.cause;
    expect_at(pose, camera_at(k), GetParam());
  }
}

TEST_P(VisualSlamOnDepth, RepeatedFramesAreAStandstill) {
  Session run(GetParam());
  run.follow(0, 10);
  Frame frame = frame_at(camera_at(10), 10, GetParam());
  for (int k = 10; k < 20; ++k) {
    SCOPED_TRACE(k);
    frame.utime = utime_of(k);
    expect_at(run.see(frame), camera_at(10), GetParam());
  }
  ++frame.utime;  // a stutter of a driver: nothing moves at a metre a second
  expect_at(run.see(frame), camera_at(10), GetParam());
  frame = frame_at(camera_at(10), 20, GetParam());
  const SlamPose pose = run.see(frame);
  EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
  expect_at(pose, camera_at(10), GetParam());
}

TEST_P(VisualSlamOnDepth, UnusableFramesAreLostAndTheNextIsNot) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  const auto fill = [](Plane<float>& plane, float value) {
    plane.values.assign(plane.size(), value);
  };
  const auto darken = [&](Frame& frame) {
    fill(frame.depth, 0);
    fill(frame.albedo, -1);
  };
  const std::vector<std::function<void(Frame&)>> faults = {
      darken,
      [&](Frame& frame) { fill(frame.depth, kNan), fill(frame.albedo, kNan); },
      [&](Frame& frame) { fill(frame.depth, kInfinity), fill(frame.albedo, kInfinity); },
      [&](Frame& frame) { fill(frame.depth, 1e-30F); },
      [&](Frame& frame) { fill(frame.depth, 1e30F), fill(frame.albedo, -1); },
      [&](Frame& frame) { fill(frame.albedo, kNan), fill(frame.depth, -1); },
  };
  Session run(GetParam());
  run.follow(0, 10);
  int k = 10;
  for (std::size_t fault = 0; fault < faults.size(); ++fault) {
    SCOPED_TRACE(fault);
    Frame frame = frame_at(camera_at(k), k, GetParam());
    faults[fault](frame);
    EXPECT_EQ(run.see(frame).status, SlamStatus::kLost);
    ++k;
    for (const int end = k + 2; k < end; ++k) {
      const SlamPose pose = run.see(k);
      EXPECT_NE(pose.status, SlamStatus::kLost) << pose.cause;
      expect_at(pose, camera_at(k), GetParam());
    }
  }
  EXPECT_TRUE(is_finite(run.slam.map().surfels()));
}

TEST_P(VisualSlamOnDepth, AlbedoAloneIsEnough) {
  Session run(GetParam());
  run.follow(0, 20);
  Frame frame = frame_at(camera_at(20), 20, GetParam());
  for (float& depth : frame.depth.values) depth = 0;
  const SlamPose pose = run.see(frame);
  EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
  expect_at(pose, camera_at(20), GetParam());
}

TEST_P(VisualSlamOnDepth, DepthAloneIsEnoughIfItIsCertain) {
  Session run(GetParam());
  run.follow(0, 20);
  Frame frame = frame_at(camera_at(20), 20, GetParam());
  for (float& albedo : frame.albedo.values) albedo = -1;
  SlamPose pose = run.see(frame);
  EXPECT_EQ(pose.status, GetParam() == kCertain ? SlamStatus::kOk : SlamStatus::kLost);
  if (pose.status == SlamStatus::kOk) expect_at(pose, camera_at(20), GetParam());
  pose = run.see(21);
  EXPECT_NE(pose.status, SlamStatus::kLost) << pose.cause;
  expect_at(pose, camera_at(21), GetParam());
}

TEST_P(VisualSlamOnDepth, JumpIsSaidAndTheCameraFoundWhereItIsKnown) {
  Session run(GetParam());
  run.follow(0, 50);
  for (int k = 50; k < 55; ++k) {
    const SlamPose pose = run.see(frame_at(kElsewhere, k, GetParam()));
    EXPECT_EQ(pose.status, SlamStatus::kLost) << k;
    EXPECT_TRUE(pose.covariance.isZero(0));
  }
  const int surfels = run.slam.map().size();
  // Back on the way where it was a second ago.
  const SlamPose found = run.see(frame_at(camera_at(33), 55, GetParam()));
  EXPECT_EQ(found.status, SlamStatus::kRelocalised) << found.cause;
  expect_at(found, camera_at(33), GetParam());
  // What was known is still there, but for surfels that lay on top of each other.
  EXPECT_GE(run.slam.map().size(), surfels - surfels / 100);
  for (int k = 56; k < 60; ++k) {
    const SlamPose pose = run.see(frame_at(camera_at(33 + k - 55), k, GetParam()));
    EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
    expect_at(pose, camera_at(33 + k - 55), GetParam());
  }
}

TEST_P(VisualSlamOnDepth, NothingIsMergedWhileLost) {
  Session run(GetParam());
  run.follow(0, 20);
  run.see(frame_at(kElsewhere, 20, GetParam()));
  run.see(frame_at(kElsewhere, 21, GetParam()));  // what was being refined is merged by now
  const SurfelArrays before = run.slam.map().surfels();
  run.see(frame_at(kElsewhere, 22, GetParam()));
  EXPECT_EQ(run.slam.map().surfels(), before);
}

TEST_P(VisualSlamOnDepth, GoesOnWithAKeptMapOnceItFindsItself) {
  Session before(GetParam());
  before.follow(0, 50);
  // Another day, not where it left off.
  const auto later = [&](const SE3& camera, int number) {
    return look(camera, utime_of(number) + 86'400'000'000, GetParam(), kAlbedoStd);
  };
  Session run(GetParam(), before.slam.kept());
  const SurfelArrays kept = run.slam.map().surfels();
  for (int k = 0; k < 3; ++k) {
    EXPECT_EQ(run.see(later(kElsewhere, k)).status, SlamStatus::kLost);
  }
  EXPECT_EQ(run.slam.map().surfels(), kept);
  EXPECT_FALSE(run.slam.kept().viewpoints.empty());
  const SlamPose found = run.see(later(camera_at(30), 3));
  EXPECT_EQ(found.status, SlamStatus::kRelocalised) << found.cause;
  expect_at(found, camera_at(30), GetParam());
  for (int k = 4; k < 14; ++k) {
    const SlamPose pose = run.see(later(camera_at(27 + k), k));
    EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
    expect_at(pose, camera_at(27 + k), GetParam());
  }
  // What is known is not mapped a second time; a rim may be new.
  EXPECT_LT(run.slam.map().size(), 1.2 * before.slam.map().size());
}

TEST_P(VisualSlamOnDepth, SameBytesHoweverManyThreadsAndHoweverSlow) {
  const auto results = [](int threads, bool loaded) {
    set_thread_count(threads);
    std::atomic<bool> done = false;
    std::vector<std::thread> load;
    for (int i = 0; loaded && i < 4; ++i) {
      load.emplace_back([&] {
        while (!done) std::this_thread::yield();
      });
    }
    Session run(GetParam());
    std::vector<SlamPose> poses;
    for (int k = 0; k < 24; ++k) {
      // The thread that refines is now behind, now ahead.
      if (loaded && k % 5 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(20));
      poses.push_back(k == 15 ? run.see(frame_at(kElsewhere, k, GetParam())) : run.see(k));
    }
    done = true;
    for (std::thread& thread : load) thread.join();
    set_thread_count(0);
    return std::pair(poses, run.slam.map().surfels());
  };
  const auto [poses, surfels] = results(1, false);
  for (const auto& [threads, loaded] : {std::pair{2, true}, {1, true}}) {
    SCOPED_TRACE(testing::Message() << threads << " threads, loaded: " << loaded);
    const auto [others, other_surfels] = results(threads, loaded);
    EXPECT_TRUE(surfels == other_surfels);
    for (std::size_t k = 0; k < poses.size(); ++k) {
      EXPECT_EQ(poses[k].status, others[k].status);
      EXPECT_EQ(poses[k].map_T_camera.matrix(), others[k].map_T_camera.matrix());
      EXPECT_EQ(poses[k].covariance, others[k].covariance);
    }
  }
}

// Errors squared over the covariance are 6 in the mean for six unknowns. One way is one draw of
// its drift, so several noises are averaged; a map that is its own measurement, robust weights and
// errors that neighbouring frames share are allowed for. Above the band covariances are promises
// not kept; far below they are worth nothing.
TEST_P(VisualSlamOnDepth, CovarianceIsThatOfTheErrors) {
  constexpr int kRuns = 10;
  constexpr int kFrames = 24;
  constexpr double kLeast = 6.0 / 10;
  constexpr double kMost = 6.0 * 2;
  VisualSlamOptions chosen = options();
  // The scene has no lamp that could leave anything; but wrong depth does the same.
  if (GetParam() == kCertain) chosen.tracker.misregistration = 0;
  double sum = 0;
  int count = 0;
  for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
    Session run(GetParam(), chosen);
    for (int k = 0; k < kFrames; ++k) {
      const SE3 truth = camera_at(k);
      const SlamPose pose = run.see(look(truth, utime_of(k), GetParam(), 2 * kAlbedoStd, seed));
      ASSERT_NE(pose.status, SlamStatus::kLost) << pose.cause;
      if (k == 0) continue;  // is the map's frame
      const Vector6d error = (pose.map_T_camera.inverse() * truth).log();
      sum += error.dot(pose.covariance.ldlt().solve(error));
      ++count;
    }
  }
  RecordProperty("nees", std::to_string(sum / count));
  EXPECT_GT(sum / count, kLeast);
  EXPECT_LT(sum / count, kMost);
}

TEST(VisualSlam, FirstFramesThatAreOfNoUseBeginNoMap) {
  const Frame good = frame_at({}, 0);
  Frame without = good;
  for (float& depth : without.depth.values) depth = 0;
  Frame speck = good;
  for (std::size_t i = 0; i < speck.depth.size(); ++i) {
    if (i % 100 != 0) speck.depth.values[i] = 0;
  }
  Frame far = good;
  for (float& depth : far.depth.values) depth *= 100;
  Frame broken = good;
  for (float& depth : broken.depth.values) depth = std::numeric_limits<float>::quiet_NaN();
  Session run;
  int k = 0;
  for (Frame frame : {without, speck, far, broken}) {
    frame.utime = utime_of(k++);
    const SlamPose pose = run.see(frame);
    EXPECT_EQ(pose.status, SlamStatus::kLost);
    EXPECT_THAT(pose.cause, HasSubstr("too little to begin a map with"));
    EXPECT_EQ(run.slam.map().size(), 0);
  }
  Frame black = good;
  black.utime = utime_of(k++);
  EXPECT_EQ(run.see(black, {"black", "the picture is black", 0}).cause, "the picture is black");
  for (const int end = k + 3; k < end; ++k) {
    const SlamPose pose = run.see(frame_at({}, k));
    EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
    expect_at(pose, {});
  }
}

TEST(VisualSlam, PictureThatLeavesNoSurfaceInTheMapIsNotOkTwice) {
  Session run;
  Frame frame = frame_at({}, 0);
  // A ramp steeper than any surface.
  for (int v = 0; v < kCameraGrid.height; ++v) {
    for (int u = 0; u < kCameraGrid.width; ++u) {
      frame.depth.at(u, v) = static_cast<float>(1e-3 * std::exp(0.08 * u));
    }
  }
  run.see(frame);
  ASSERT_EQ(run.slam.map().size(), 0);
  frame.utime = utime_of(1);
  EXPECT_EQ(run.see(frame).status, SlamStatus::kDegraded);
  for (int k = 2; k < 5; ++k) run.see(frame_at({}, k));
  EXPECT_GT(run.slam.map().size(), 0);
  const SlamPose pose = run.see(frame_at({}, 5));
  EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
}

TEST(VisualSlam, BlackPicturesAreLostAndNothingElseIs) {
  Session run;
  run.follow(0, 10);
  for (int k = 10; k < 14; ++k) {
    const SlamPose pose = run.see(frame_at(camera_at(k), k), {"black", "", 0});
    EXPECT_EQ(pose.status, SlamStatus::kLost);
    EXPECT_EQ(pose.cause, "black");
    expect_at(pose, camera_at(9));  // the last that is known
  }
  const SlamPose pose = run.see(14);
  EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
  expect_at(pose, camera_at(14));
}

TEST(VisualSlam, BlurredPicturesAreDegradedAndNotMerged) {
  constexpr double kSharp = 0.02;
  Session run;
  for (int k = 0; k < 10; ++k) run.see(frame_at(camera_at(k), k), {"", "", kSharp});
  const SurfelArrays before = run.slam.map().surfels();
  const SlamPose blurred = run.see(frame_at(camera_at(10), 10), {"", "", kSharp / 4});
  EXPECT_EQ(blurred.status, SlamStatus::kDegraded);
  EXPECT_THAT(blurred.cause, HasSubstr("blur"));
  expect_at(blurred, camera_at(10));
  EXPECT_EQ(run.slam.map().surfels(), before);
  const SlamPose sharp = run.see(frame_at(camera_at(11), 11), {"", "", kSharp});
  EXPECT_EQ(sharp.status, SlamStatus::kOk) << sharp.cause;
  EXPECT_NE(run.slam.map().surfels(), before);
}

// A plain tube along the z axis, which the camera moves along.
TEST(VisualSlam, PlainTubeIsDegradedAndNamesItsAxis) {
  constexpr double kRadius = 0.015;
  constexpr double kFarthest = 0.1;
  Session run;
  for (int k = 0; k < 8; ++k) {
    Frame frame = frame_at({}, k);
    const CounterRandom random(1, static_cast<std::uint64_t>(k));
    for (int v = 0; v < kCameraGrid.height; ++v) {
      for (int u = 0; u < kCameraGrid.width; ++u) {
        const double off = std::hypot((u - kCameraGrid.cx) / kCameraGrid.fx,
                                      (v - kCameraGrid.cy) / kCameraGrid.fy);
        const double depth = kRadius / off;
        const auto [a, b] =
            random.normal_pair(static_cast<std::uint64_t>(v * kCameraGrid.width + u));
        frame.depth.at(u, v) =
            depth < kFarthest ? static_cast<float>(depth * (1 + kCertain * a)) : 0.0F;
        frame.albedo.at(u, v) = depth < kFarthest ? static_cast<float>(0.5 + 0.005 * b) : -1.0F;
      }
    }
    const SlamPose pose = run.see(frame);
    if (k == 0) continue;
    SCOPED_TRACE(k);
    EXPECT_EQ(pose.status, SlamStatus::kDegraded);
    EXPECT_THAT(pose.cause, HasSubstr("no hold along the camera's z axis"));
    EXPECT_GT(pose.covariance(2, 2), 100 * pose.covariance(0, 0));
  }
}

TEST(VisualSlam, AnotherGridIsRefusedAndChangesNothing) {
  const auto coarse = [](Frame frame, int factor) {
    frame.grid = frame.grid.coarser(factor);
    frame.depth = Plane<float>(frame.grid.width, frame.grid.height, 0.03F);
    frame.albedo = Plane<float>(frame.grid.width, frame.grid.height, 0.5F);
    return frame;
  };
  Session run;
  EXPECT_THROW(run.slam.track(coarse(frame_at({}, 0), 4), {}), std::invalid_argument);
  Frame empty = coarse(frame_at({}, 1), 1);
  empty.grid.fx += 1;  // as long as nothing was merged, any will do
  for (float& depth : empty.depth.values) depth = 0;
  EXPECT_EQ(run.see(empty).status, SlamStatus::kLost);
  run.follow(2, 5);
  const SurfelArrays before = run.slam.map().surfels();
  empty.utime = utime_of(5);
  EXPECT_THROW(run.slam.track(empty, {}), std::invalid_argument);
  EXPECT_EQ(run.slam.map().surfels(), before);
  const SlamPose pose = run.see(6);
  EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
}

TEST(VisualSlam, OptionsThatMakeNoSenseAreRefused) {
  for (const auto& spoil : std::vector<std::function<void(VisualSlamOptions&)>>{
           [](auto& o) { o.keyframe_shift = 0; },
           [](auto& o) { o.keyframe_turn = std::nan(""); },
           [](auto& o) { o.refinement_frames = 0; },
           [](auto& o) { o.candidates = -1; },
           [](auto& o) { o.map.working_distance = 0; },
       }) {
    VisualSlamOptions spoiled = options();
    spoil(spoiled);
    EXPECT_THROW(VisualSlam{spoiled}, std::invalid_argument);
  }
}

// Where the scene is in the rig.
const SE3 kRigTScene{so3_exp({2.5, 0.7, -0.4}), {0.02, -0.03, -0.06}};
// What makes the depth metric that the frames below have; and how far that is off at the wall.
constexpr double kDepthScale = 1.03;
constexpr double kWrongScale = (1 - 1 / kDepthScale) * kWallDistance;

Frame shrunk(Frame frame) {
  for (float& depth : frame.depth.values) depth /= static_cast<float>(kDepthScale);
  return frame;
}

// Fusion that is right, and knows it.
FusedState fused_at(const SE3& scene_T_camera, std::int64_t utime) {
  constexpr double kStd = 1e-4;  // metres, radians
  FusedState fused;
  fused.utime = utime;
  fused.is_known = fused.is_nominal = true;
  fused.rig_T_camera = kRigTScene * scene_T_camera;
  fused.covariance = kStd * kStd * Matrix6d::Identity();
  fused.depth_scale = kDepthScale;
  return fused;
}
FusedState fused_at(int number) { return fused_at(camera_at(number), utime_of(number)); }

// Frames of a depth that is wrong by a factor, each answered by fusion.
struct FusedSession : Session {
  using Session::Session;
  SlamPose see_fused(int number) {
    return see(shrunk(frame_at(camera_at(number), number, relative_std)), {}, fused_at(number));
  }
  void follow_fused(int begin, int end) {
    for (int number = begin; number < end; ++number) see_fused(number);
  }
};

TEST_P(VisualSlamOnDepth, TrustedFusedPoseTakesTheMapToTheRigAndToMetres) {
  constexpr int kFirst = 20;
  FusedSession run(GetParam());
  for (int k = 0; k < kFirst; ++k) run.see(shrunk(frame_at(camera_at(k), k, GetParam())));
  EXPECT_FALSE(run.slam.is_in_rig_frame());
  run.follow_fused(kFirst, kFirst + 3);  // a keyframe may be under way
  EXPECT_EQ(run.slam.map_version(), 1);
  for (int k = kFirst + 3; k < 60; ++k) {
    SCOPED_TRACE(k);
    const SlamPose pose = run.see_fused(k);
    EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
    EXPECT_EQ(pose.map_version, 1);
    expect_at(pose, kRigTScene * camera_at(k), GetParam());
  }
  EXPECT_NEAR(run.slam.depth_scale(), kDepthScale, 1e-9);
  // The surfels are on the wall.
  const SurfelArrays& s = run.slam.map().surfels();
  std::vector<double> off;
  for (const std::size_t id : s.at_least(3)) {
    const Eigen::Vector3d point =
        kRigTScene.inverse() * Eigen::Vector3f(s.x[id], s.y[id], s.z[id]).cast<double>();
    off.push_back(std::abs(point.z() - wall_height(point.x(), point.y())));
    const Eigen::Vector3d normal = kRigTScene.rotation.conjugate() *
                                   Eigen::Vector3f(s.nx[id], s.ny[id], s.nz[id]).cast<double>();
    EXPECT_LT(normal.z(), 0);
  }
  ASSERT_GT(off.size(), 1000U);
  std::nth_element(off.begin(), off.begin() + static_cast<std::ptrdiff_t>(off.size() / 2),
                   off.end());
  EXPECT_LT(off[off.size() / 2], std::max(kWrongScale / 3, GetParam() * kWallDistance));
}

TEST(VisualSlam, FirstFrameMayBeginInTheRig) {
  FusedSession run;
  run.follow_fused(0, 2);
  EXPECT_EQ(run.slam.map_version(), 1);
  expect_at(run.see_fused(2), kRigTScene * camera_at(2));
}

TEST(VisualSlam, FusionThatIsNotTrustedChangesNothing) {
  constexpr int kFrames = 12;
  const auto run_with = [](const std::function<void(FusedState&)>& spoil) {
    Session run(kUncertain);
    std::vector<Eigen::Matrix4d> poses;
    for (int k = 0; k < kFrames; ++k) {
      std::optional<FusedState> fused;
      if (spoil) spoil(fused.emplace(fused_at(k)));
      poses.push_back(
          run.see(frame_at(camera_at(k), k, kUncertain), {}, fused).map_T_camera.matrix());
    }
    EXPECT_EQ(run.slam.map_version(), 0);
    EXPECT_FALSE(run.slam.is_in_rig_frame());
    return std::pair(poses, run.slam.map().surfels());
  };
  const auto expected = run_with({});
  for (const auto& spoil : std::vector<std::function<void(FusedState&)>>{
           [](auto& fused) { fused.is_known = fused.is_nominal = false; },
           [](auto& fused) { fused.depth_scale.reset(); },
           [](auto& fused) { fused.covariance(1, 1) = std::pow(3e-3, 2); },
           [](auto& fused) { fused.covariance(5, 5) = std::pow(0.06, 2); },
       }) {
    EXPECT_TRUE(run_with(spoil) == expected);
  }
}

// Sensor fusion tells scales of the map from the steps of its version.
TEST_P(VisualSlamOnDepth, ScaleChangesOnlyWithTheVersion) {
  FusedSession run(GetParam());
  run.follow_fused(0, 10);
  ASSERT_EQ(run.slam.map_version(), 1);
  const auto see_scaled = [&run](int k, double depth_scale) {
    FusedState fused = fused_at(k);
    fused.depth_scale = depth_scale;
    run.see(shrunk(frame_at(camera_at(k), k, GetParam())), {}, fused);
  };
  constexpr double kLittle = 1.005;  // less than is worth a new map
  for (int k = 10; k < 20; ++k) see_scaled(k, kLittle * kDepthScale);
  EXPECT_EQ(run.slam.map_version(), 1);
  EXPECT_NEAR(run.slam.depth_scale(), kDepthScale, 1e-9);
  constexpr double kMuch = 1.02;
  for (int k = 20; k < 25; ++k) see_scaled(k, kMuch * kDepthScale);  // a keyframe may be under way
  EXPECT_EQ(run.slam.map_version(), 2);
  EXPECT_NEAR(run.slam.depth_scale(), kMuch * kDepthScale, 1e-9);
}

// The map of a stomach that was gone round is not moved because vision has drifted since.
TEST(VisualSlam, SettledMapStaysWhenVisionIsSetAnew) {
  constexpr int kFirst = 30;
  FusedSession run(kUncertain);
  run.follow_fused(0, kFirst);
  ASSERT_EQ(run.slam.map_version(), 1);
  const int frame = run.slam.map_frame();
  // Another place, and another scale, of the camera than vision has.
  constexpr double kMuch = 1.02;
  const SE3 drift{so3_exp({0.02, -0.01, 0.03}), {5e-4, -3e-4, 2e-4}};
  const SurfelArrays before = run.slam.map().surfels();
  int k = kFirst;
  SlamPose pose;
  for (; run.slam.map_version() == 1 && k < kFirst + 5; ++k) {
    FusedState fused = fused_at(k);
    fused.rig_T_camera = drift * fused.rig_T_camera;
    fused.depth_scale = kMuch * kDepthScale;
    run.see(shrunk(frame_at(camera_at(k), k, kUncertain)), {}, fused);
  }
  ASSERT_EQ(run.slam.map_version(), 2);
  EXPECT_EQ(run.slam.map_frame(), frame);
  // What was sure of its place is where it was, but for what the last frames made of it: they weigh
  // no more than their share of its confidence.
  const SurfelArrays& after = run.slam.map().surfels();
  constexpr double kShift = 5e-4;  // metres, of the drift
  std::vector<double> moved;
  for (const std::size_t id : before.at_least(3)) {
    if (!after.holds(id)) continue;
    moved.push_back((Eigen::Vector3f(after.x[id], after.y[id], after.z[id]) -
                     Eigen::Vector3f(before.x[id], before.y[id], before.z[id]))
                        .cast<double>()
                        .norm());
  }
  ASSERT_GT(moved.size(), 500U);
  std::nth_element(moved.begin(), moved.begin() + static_cast<std::ptrdiff_t>(moved.size() / 2),
                   moved.end());
  EXPECT_LT(moved[moved.size() / 2], kShift / 3);
  // Vision goes on from there.
  pose = run.see(shrunk(frame_at(camera_at(k), k, kUncertain)), {}, std::nullopt);
  EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
  expect_at(pose, drift * kRigTScene * camera_at(k), kUncertain);
}

// The camera's way with fusion that has it, from a moment on, farther along the view than vision.
struct BentRun {
  std::vector<SlamPose> poses;
  std::vector<MapDeformation> bends;
  SurfelArrays surfels;
  // Metres, median over the surfels, by which they are behind the wall.
  double behind_wall = 0;
};
// `missing_every` frames a state of fusion's does not come; 0: all come.
BentRun drift_from_fusion(double drift, bool deform, int threads = 0, int missing_every = 0) {
  constexpr int kUntilThen = 20;  // frames
  set_thread_count(threads);
  VisualSlamOptions chosen = options();
  chosen.deform = deform;
  FusedSession run(kUncertain, chosen);
  BentRun result;
  for (int k = 0; k < 120; ++k) {
    FusedState fused = fused_at(k);
    if (k >= kUntilThen) {
      fused.rig_T_camera.translation += kRigTScene.rotation * Eigen::Vector3d(0, 0, drift);
    }
    const bool comes = missing_every == 0 || k % missing_every != 0;
    result.poses.push_back(run.see(shrunk(frame_at(camera_at(k), k, kUncertain)), {},
                                   comes ? std::optional(fused) : std::nullopt));
    for (MapDeformation& bend : run.slam.take_deformations()) {
      if (bend.report.is_accepted()) result.bends.push_back(std::move(bend));
    }
  }
  set_thread_count(0);
  result.surfels = run.slam.map().surfels();
  std::vector<double> behind;
  for (const std::size_t id : result.surfels.at_least(3)) {
    const Eigen::Vector3f position(result.surfels.x[id], result.surfels.y[id],
                                   result.surfels.z[id]);
    const Eigen::Vector3d point = kRigTScene.inverse() * position.cast<double>();
    behind.push_back(point.z() - wall_height(point.x(), point.y()));
  }
  std::nth_element(behind.begin(), behind.begin() + static_cast<std::ptrdiff_t>(behind.size() / 2),
                   behind.end());
  result.behind_wall = behind[behind.size() / 2];
  return result;
}

TEST(VisualSlam, StatesOfFusionThatAreMissingNowAndThenAreNoSilence) {
  constexpr int kMissingEvery = 2;
  const BentRun rigid = drift_from_fusion(1e-3, false, 0, kMissingEvery);
  const BentRun bent = drift_from_fusion(1e-3, true, 0, kMissingEvery);
  ASSERT_FALSE(bent.bends.empty());
  ASSERT_EQ(bent.poses.size(), rigid.poses.size());
  for (std::size_t k = 0; k < bent.poses.size(); ++k) {
    EXPECT_EQ(bent.poses[k].map_version, rigid.poses[k].map_version);
    EXPECT_EQ(bent.poses[k].map_T_camera.matrix(), rigid.poses[k].map_T_camera.matrix()) << k;
  }
}

TEST(VisualSlam, MapBendsToWhereFusionHasItsCamerasAndNoPoseJumps) {
  constexpr double kDrift = 1e-3;  // metres: far more than what fusion's sigma of 0.1 mm allows
  const BentRun rigid = drift_from_fusion(kDrift, false);
  const BentRun bent = drift_from_fusion(kDrift, true);
  EXPECT_TRUE(rigid.bends.empty());
  ASSERT_FALSE(bent.bends.empty());
  for (const MapDeformation& bend : bent.bends) {
    EXPECT_EQ(bend.kind, DeformationKind::kFrame);
    EXPECT_LT(bend.report.mean_error_after, bend.report.mean_error_before / 2);
  }
  // A bend may leave what does not count: a hundredth of the distance.
  constexpr double kLeft = 0.01 * kWallDistance;
  EXPECT_NEAR(bent.behind_wall - rigid.behind_wall, kDrift, kLeft);
  ASSERT_EQ(bent.poses.size(), rigid.poses.size());
  for (std::size_t k = 0; k < bent.poses.size(); ++k) {
    EXPECT_EQ(bent.poses[k].map_version, rigid.poses[k].map_version);
    EXPECT_EQ(bent.poses[k].map_T_camera.matrix(), rigid.poses[k].map_T_camera.matrix()) << k;
  }
}

TEST(VisualSlam, FusionThatAgreesBendsNothing) {
  EXPECT_TRUE(drift_from_fusion(0, true).bends.empty());
}

TEST(VisualSlam, BendsAreTheSameBytesHoweverManyThreads) {
  const BentRun one = drift_from_fusion(1e-3, true, 1);
  const BentRun two = drift_from_fusion(1e-3, true, 2);
  ASSERT_FALSE(one.bends.empty());
  EXPECT_EQ(one.bends.size(), two.bends.size());
  EXPECT_TRUE(one.surfels == two.surfels);
}

TEST_P(VisualSlamOnDepth, WhatWasMappedLongAgoIsFoundToAgree) {
  VisualSlamOptions chosen = options();
  chosen.map.active_window = 1.5;  // seconds; the camera is back after 4.5
  Session run(GetParam(), chosen);
  run.follow(0, 20);
  EXPECT_EQ(run.slam.agreements(), 0);
  run.follow(20, 110);
  EXPECT_GT(run.slam.agreements(), 0);
}

TEST_P(VisualSlamOnDepth, LostCameraIsFoundAtTheFusedPose) {
  FusedSession run(GetParam());
  run.follow_fused(0, 60);
  // Hidden while it goes back to where it was two seconds ago; fusion knows.
  const auto back = [](int k) { return camera_at(20 + k - 70); };
  for (int k = 60; k < 70; ++k) {
    run.see(frame_at({}, k), {"fluid", "", 0}, fused_at(back(k), utime_of(k)));
  }
  for (int k = 70; k < 73; ++k) {
    const SlamPose pose =
        run.see(shrunk(frame_at(back(k), k, GetParam())), {}, fused_at(back(k), utime_of(k)));
    EXPECT_NE(pose.status, SlamStatus::kLost) << pose.cause;
    expect_at(pose, kRigTScene * back(k), GetParam());
  }
  EXPECT_EQ(run.slam.map_version(), 1);
}

// Nothing in view from there is known, even if that it is there is.
const SE3 kFarAway{Eigen::Quaterniond::Identity(), {0.1, 0, 0}};

TEST_P(VisualSlamOnDepth, UnknownTissueIsMappedFromTheFusedPose) {
  FusedSession run(GetParam());
  run.follow_fused(0, 30);
  const auto there = [](int k) { return kFarAway * camera_at(k); };
  int k = 30;
  for (; k < 30 + frames_in(options().restart_after); ++k) {
    const SlamPose pose =
        run.see(shrunk(frame_at(there(k), k, GetParam())), {}, fused_at(there(k), utime_of(k)));
    EXPECT_EQ(pose.status, SlamStatus::kLost) << k;
    EXPECT_EQ(pose.map_version, 1);
  }
  for (bool first = true; k < 60; ++k, first = false) {
    SCOPED_TRACE(k);
    const SlamPose pose =
        run.see(shrunk(frame_at(there(k), k, GetParam())), {}, fused_at(there(k), utime_of(k)));
    EXPECT_EQ(pose.status, first ? SlamStatus::kRelocalised : SlamStatus::kOk) << pose.cause;
    EXPECT_EQ(pose.cause, first ? "began again at the fused pose" : "");
    EXPECT_EQ(pose.map_version, 2);
    // The fused pose is that of the frame before, moved on.
    const SE3 truth = kRigTScene * there(k);
    const PoseError error = error_of(pose.map_T_camera, truth);
    constexpr double kFrameMetres = 1e-3;
    constexpr double kFrameRadians = 0.02;
    EXPECT_LT(error.metres, kFrameMetres + std::max(kPixelMetres, GetParam() * kWallDistance));
    EXPECT_LT(error.radians, kFrameRadians + std::max(kPixelRadians, GetParam()));
  }
  // What was known before still is.
  for (int i = 0; i < 3; ++i, ++k) {
    const SlamPose pose = run.see(shrunk(frame_at(camera_at(10 + i), k, GetParam())), {},
                                  fused_at(camera_at(10 + i), utime_of(k)));
    EXPECT_TRUE(i == 0 || pose.status != SlamStatus::kLost) << pose.cause;
  }
  EXPECT_EQ(run.slam.map_version(), 2);
}

// Other tissue than was there, and nearer.
TEST(VisualSlam, WallThatHasMovedIsMappedAnewAndTheOldOneForgotten) {
  constexpr float kNearer = 0.8F;
  const auto moved = [](int k) {
    Frame frame = shrunk(frame_at(kFarAway * camera_at(k), k, kUncertain));
    for (float& depth : frame.depth.values) depth *= kNearer;
    return frame;
  };
  FusedSession run(kUncertain);
  run.follow_fused(0, 30);
  int k = 30;
  while (k < 60 && run.slam.map_version() == 1) {
    run.see(moved(k), {}, fused_at(k));
    ++k;
  }
  ASSERT_EQ(run.slam.map_version(), 2);
  for (const int end = k + 30; k < end; ++k) {
    const SlamPose pose = run.see(moved(k), {}, fused_at(k));
    EXPECT_NE(pose.status, SlamStatus::kLost) << pose.cause;
    EXPECT_EQ(pose.map_version, 2);
  }
  // In the middle of what was seen all the time there is one wall, and that is the new one.
  const SurfelArrays& s = run.slam.map().surfels();
  constexpr double kMiddle = 5e-3;
  int old = 0;
  int all = 0;
  for (const std::size_t id : s.at_least(options().map.stable_confidence)) {
    const Eigen::Vector3d point =
        kRigTScene.inverse() * Eigen::Vector3f(s.x[id], s.y[id], s.z[id]).cast<double>();
    if (point.head<2>().norm() > kMiddle) continue;
    ++all;
    if (point.z() > (1 + kNearer) / 2 * kWallDistance) ++old;
  }
  EXPECT_GT(all, 100);
  EXPECT_LT(old, all / 20);
}

TEST(VisualSlam, BeginsAgainOnlyWithAGoodPictureAndATrustedPose) {
  constexpr int kFrames = 12;  // fewer than a new map takes
  const auto version_after = [](const auto& spoil) {
    FusedSession run;
    for (int k = 0; k < 10; ++k) {
      run.see(shrunk(frame_at(camera_at(k), k)), {"", "", 0.02}, fused_at(k));
    }
    for (int k = 10; k < 10 + kFrames; ++k) {
      Frame frame = shrunk(frame_at(kFarAway, k));
      PictureHealth health{"", "", 0.02};
      std::optional<FusedState> fused = fused_at(kFarAway, utime_of(k));
      spoil(frame, health, fused);
      const SlamPose pose = run.see(frame, health, fused);
      EXPECT_EQ(pose.status == SlamStatus::kLost, pose.map_version == 1) << k << pose.cause;
      if (pose.map_version > 1) break;
    }
    return run.slam.map_version();
  };
  EXPECT_EQ(version_after([](auto&, auto&, auto&) {}), 2);
  EXPECT_EQ(version_after([](auto&, auto& health, auto&) { health.failure = "fluid"; }), 1);
  EXPECT_EQ(version_after([](auto&, auto&, auto& fused) { fused.reset(); }), 1);
  EXPECT_EQ(version_after([](auto&, auto&, auto& fused) { fused->is_known = false; }), 1);
  EXPECT_EQ(version_after([](auto&, auto&, auto& fused) { fused->covariance(0, 0) = 2e-5; }), 1);
  EXPECT_EQ(version_after([](auto&, auto&, auto& fused) { fused->covariance(3, 3) = 0.02; }), 1);
  EXPECT_EQ(version_after([](auto& frame, auto&, auto&) {
              for (std::size_t i = 0; i < frame.depth.size(); ++i) {
                if (i % 10 != 0) frame.depth.values[i] = 0;
              }
            }),
            1);
}

TEST_P(VisualSlamOnDepth, KeptMapInTheRigIsUsedAsItIs) {
  FusedSession before(GetParam());
  before.follow_fused(0, 50);
  const KeptMap kept = before.slam.kept();
  EXPECT_NEAR(kept.depth_scale, kDepthScale, 1e-9);
  FusedSession run(GetParam(), kept);
  EXPECT_TRUE(run.slam.is_in_rig_frame());
  for (int k = 30; k < 40; ++k) {
    const SlamPose pose = run.see_fused(k);
    EXPECT_EQ(pose.status, k == 30 ? SlamStatus::kRelocalised : SlamStatus::kOk) << pose.cause;
    expect_at(pose, kRigTScene * camera_at(k), GetParam());
  }
  EXPECT_EQ(run.slam.map_version(), 0);
}

// The magnet tells all but the roll, and after a while without vision nobody knows that.
TEST(VisualSlam, UnknownRollBeginsANewMapThatJoinsTheOldOneInTheRig) {
  constexpr int kLost = 20;
  constexpr int kKnown = 60;  // the roll, from here on
  const auto there = [](int k) { return kFarAway * camera_at(k); };
  FusedSession run;
  run.follow_fused(0, kLost);
  const int known = run.slam.map().size();
  int k = kLost;
  for (; k < kKnown; ++k) {
    FusedState fused = fused_at(there(k), utime_of(k));
    fused.covariance(5, 5) = 1;
    const SlamPose pose = run.see(shrunk(frame_at(there(k), k)), {}, fused);
    EXPECT_EQ(pose.status == SlamStatus::kLost, k < kLost + frames_in(options().new_map_after))
        << k;
  }
  EXPECT_EQ(run.slam.map_version(), 2);
  EXPECT_FALSE(run.slam.is_in_rig_frame());
  EXPECT_GT(run.slam.kept().depth_scale, 0);  // what is kept is the old one, which is in the rig
  EXPECT_EQ(run.slam.kept().surfels.size(), static_cast<std::size_t>(known));
  for (; k < kKnown + 5; ++k) {
    const SlamPose pose =
        run.see(shrunk(frame_at(there(k), k)), {}, fused_at(there(k), utime_of(k)));
    EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
    if (k > kKnown) expect_at(pose, kRigTScene * there(k));
  }
  EXPECT_EQ(run.slam.map_version(), 3);
  EXPECT_EQ(run.slam.map_frame(), 3);
  EXPECT_GT(run.slam.map().size(), known * 3 / 2);
  // Back in the old part, which is where it was.
  for (int i = 0; i < 3; ++i, ++k) {
    const SlamPose pose = run.see(shrunk(frame_at(camera_at(10 + i), k)), {},
                                  fused_at(camera_at(10 + i), utime_of(k)));
    EXPECT_NE(pose.status, SlamStatus::kLost) << pose.cause;
    expect_at(pose, kRigTScene * camera_at(10 + i));
  }
  EXPECT_EQ(run.slam.map_version(), 3);
}

}  // namespace
}  // namespace gastronaut::slam

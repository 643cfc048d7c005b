#include "visual_slam/visual_slam.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <functional>
#include <limits>
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

  SlamPose see(const Frame& frame, const PictureHealth& health = {}) {
    const SlamPose pose = slam.track(frame, health);
    slam.merge();
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
    const bool well = pose.status == SlamStatus::kOk || pose.status == SlamStatus::kRelocalised;
    EXPECT_EQ(well, pose.cause.empty()) << pose.cause;
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
  EXPECT_GE(run.slam.map().size(), surfels);  // what was known is still there
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

// The same picture merged at two poses is in the map at their mean.
TEST(VisualSlam, FusedPoseIsWhereTheFrameGoes) {
  constexpr double kFused = 0.3e-3;  // metres; a third of what is taken for another surface
  constexpr double kTolerance = 0.05e-3;
  Session run;
  run.see(frame_at({}, 0));
  run.slam.track(frame_at({}, 1), {});
  run.slam.merge(SE3{Eigen::Quaterniond::Identity(), {0, 0, kFused}});
  const SlamPose pose = run.see(frame_at({}, 2));
  EXPECT_EQ(pose.status, SlamStatus::kOk) << pose.cause;
  EXPECT_NEAR(pose.map_T_camera.translation.z(), kFused / 2, kTolerance);
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

}  // namespace
}  // namespace gastronaut::slam

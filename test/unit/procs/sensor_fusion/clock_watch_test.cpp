#include "sensor_fusion/clock_watch.hpp"

#include <gtest/gtest.h>

#include "unit/procs/sensor_fusion/simulated_capsule.hpp"

namespace gastronaut::fusion {
namespace {

using test::Draw;
using test::Scenario;
using test::true_pose;

constexpr double kFrame = 0.05;  // seconds
constexpr double kNoise = 3e-4;  // metres, of a fix
constexpr double kSigmas = 4;
constexpr double kUseful = 5e-3;  // seconds: what a warning needs at least

std::int64_t utime_of(double seconds) { return std::llround(1e6 * seconds); }

Eigen::Vector3d magnet(double time, const Scenario& scenario) {
  return true_pose(time, scenario) * scenario.camera_T_magnet.translation;
}

struct Path {
  double offset = 0;  // seconds
  double seconds = 30;
  Eigen::Quaterniond told = Eigen::Quaterniond::Identity();  // rig_R_map that is told
  double scale = 1;
  Eigen::Vector3d drift = Eigen::Vector3d::Zero();  // of the fixes, metres a second
  Scenario scenario;
};

void follow(const Path& path, std::uint64_t seed, ClockWatch& watch) {
  Draw draw(seed, 1);
  const int frames = static_cast<int>(path.seconds / kFrame);
  for (int i = 1; i < frames; ++i) {
    for (double t = (i - 1) * kFrame; t < i * kFrame - 1e-9; t += test::kMagneticInterval) {
      watch.add_fix(utime_of(t), magnet(t + path.offset, path.scenario) + t * path.drift +
                                     kNoise * draw.vector());
    }
    const Eigen::Vector3d moved =
        magnet(i * kFrame, path.scenario) - magnet((i - 1) * kFrame, path.scenario);
    watch.add_path(utime_of((i - 1) * kFrame), utime_of(i * kFrame), path.scale * moved, path.told);
  }
}

TEST(ClockWatch, FindsTheOffset) {
  for (const double offset : {-0.03, 0.0, 0.02}) {
    ClockWatch watch;
    Path path;
    path.offset = offset;
    follow(path, 1, watch);
    const ClockEstimate estimate = watch.estimate();
    EXPECT_LT(estimate.std, kUseful);
    EXPECT_NEAR(estimate.offset, offset, kSigmas * estimate.std);
  }
}

// One sigma is the spread of estimates over many rigs, within what 40 of them tell: the errors are
// white here, the watch allows for some that stay alike, so it may be larger.
TEST(ClockWatch, StatesItsSpread) {
  constexpr int kRigs = 40;
  double square = 0;
  for (std::uint64_t seed = 1; seed <= kRigs; ++seed) {
    ClockWatch watch;
    follow({}, seed, watch);
    square += std::pow(watch.estimate().offset / watch.estimate().std, 2) / kRigs;
  }
  // 95 % of chi-squares of 40 numbers, divided by 40, are below 1.48.
  EXPECT_LT(square, 1.48);
}

TEST(ClockWatch, IsNotDeceivedByTheMapsRotationScaleAndDrift) {
  ClockWatch watch;
  Path path;
  path.offset = 0.02;
  path.told = so3_exp({0.05, -0.08, 0.06});
  path.scale = 1.05;
  path.drift = {1e-4, -5e-5, 0};  // a hundredth of the path
  follow(path, 1, watch);
  const ClockEstimate estimate = watch.estimate();
  EXPECT_LT(estimate.std, kUseful);
  EXPECT_NEAR(estimate.offset, path.offset, kSigmas * estimate.std);
}

TEST(ClockWatch, KnowsNothingWithoutMotion) {
  ClockWatch watch;
  Path path;
  path.scenario.pace = 0;
  follow(path, 1, watch);
  EXPECT_GT(watch.estimate().std, 1);  // second
  EXPECT_GT(ClockWatch().estimate().std, 1);
}

TEST(ClockWatch, KeepsWhatItKnowsOverGapsAndJumps) {
  ClockWatch watch;
  Path path;
  path.offset = 0.02;
  follow(path, 1, watch);
  watch.forget_path();
  path.seconds = 0.3;
  follow(path, 2, watch);
  const ClockEstimate estimate = watch.estimate();
  EXPECT_LT(estimate.std, kUseful);
  EXPECT_NEAR(estimate.offset, path.offset, kSigmas * estimate.std);
}

}  // namespace
}  // namespace gastronaut::fusion

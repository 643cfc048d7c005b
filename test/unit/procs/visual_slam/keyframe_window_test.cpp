#include "visual_slam/keyframe_window.hpp"

#include <gtest/gtest.h>
#include <hwy/highway.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <stdexcept>
#include <vector>

#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kMillimetre = 1e-3;
constexpr double kDegree = M_PI / 180;
constexpr double kDistance = 0.03;  // metres, of the wall
// Half the resolution in use, so that tests are short.
const PinholeGrid kGrid{160, 120, 83.2, 83.2, 80.2, 59.2};

// What depth from shading gets wrong: as much as its relative_std says.
constexpr double kRelativeStd = 0.04;
constexpr double kSmoothError = 0.05;  // amplitude of waves: relative_std times sqrt 2, nearly
constexpr double kScaleError = 0.03;
// What tracking leaves: a third of a millimetre and of a degree, about half a pixel.
constexpr double kTrackingError = 0.3 * kMillimetre;
constexpr double kTrackingTurn = 0.3 * kDegree;

double height_of_wall(double x, double y) {
  return kDistance + 2e-3 * std::sin(250 * x + 0.5) * std::cos(200 * y) +
         1e-3 * std::sin(310 * y + 200 * x);
}
// Waves of 3 to 9 mm, which are 8 to 25 pixels, like vessels.
double vessels(double x, double y) {
  return 0.5 + 0.08 * std::sin(900 * x + 300 * y) * std::cos(700 * y - 200 * x) +
         0.06 * std::sin(1500 * x - 1900 * y + 1) + 0.05 * std::cos(2100 * x + 1100 * y);
}
double plain(double, double) { return 0.5; }

using Albedo = std::function<double(double, double)>;

Frame true_frame(const SE3& map_T_camera, std::int64_t utime, const Albedo& albedo = vessels) {
  Frame frame;
  frame.utime = utime;
  frame.grid = kGrid;
  frame.relative_std = kRelativeStd;
  frame.depth = Plane<float>(kGrid.width, kGrid.height);
  frame.albedo = Plane<float>(kGrid.width, kGrid.height);
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      const Eigen::Vector3d ray((u - kGrid.cx) / kGrid.fx, (v - kGrid.cy) / kGrid.fy, 1);
      const Eigen::Vector3d way = map_T_camera.rotation * ray;
      // The wall's slopes are below one: this contracts.
      double depth = kDistance;
      Eigen::Vector3d point;
      for (int i = 0; i < 60; ++i) {
        point = map_T_camera.translation + depth * way;
        depth -= 0.7 * (point.z() - height_of_wall(point.x(), point.y()));
      }
      frame.depth.at(u, v) = static_cast<float>(depth);
      frame.albedo.at(u, v) = static_cast<float>(albedo(point.x(), point.y()));
    }
  }
  return frame;
}

// Waves as long as the picture is high, others in each frame; and a factor.
void spoil_depth(double scale, std::uint64_t seed, Frame& frame) {
  const CounterRandom random(seed, 0);
  const double phase_u = 2 * M_PI * random.uniform(0);
  const double phase_v = 2 * M_PI * random.uniform(1);
  const double wave = 2 * M_PI / kGrid.height;
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      const double off = kSmoothError * std::sin(wave * u + phase_u) * std::sin(wave * v + phase_v);
      frame.depth.at(u, v) *= static_cast<float>(scale * std::exp(off));
    }
  }
}

// Sideways and back in an arc, looking at the wall: 2 mm, a pixel in fourteen, from one to the
// next.
SE3 true_pose(int keyframe) {
  const double at = 2 * kMillimetre * keyframe;
  return {so3_exp({0.01 * keyframe, -0.02 * keyframe, 0.03 * keyframe}),
          {at, 0.4 * at, 1 * kMillimetre * std::sin(keyframe)}};
}

Vector6d tracking_error(int keyframe) {
  const CounterRandom random(7, static_cast<std::uint64_t>(keyframe));
  Vector6d twist;
  for (int i = 0; i < 6; ++i) {
    twist(i) = (i < 3 ? kTrackingError : kTrackingTurn) * random.normal(static_cast<unsigned>(i));
  }
  return twist;
}

struct Given {
  Frame frame;
  Plane<float> true_depth;
  SE3 map_T_camera;
};

Given given(int keyframe, const Albedo& albedo = vessels) {
  Given result;
  result.frame = true_frame(true_pose(keyframe), 1000 * keyframe, albedo);
  result.true_depth = result.frame.depth;
  spoil_depth(1 + kScaleError * (keyframe % 2 == 0 ? 1 : -1), static_cast<std::uint64_t>(keyframe),
              result.frame);
  result.map_T_camera = true_pose(keyframe);
  if (keyframe > 0) result.map_T_camera = result.map_T_camera * SE3::exp(tracking_error(keyframe));
  return result;
}

std::vector<Given> given_keyframes(int count, const Albedo& albedo = vessels) {
  std::vector<Given> result;
  for (int k = 0; k < count; ++k) result.push_back(given(k, albedo));
  return result;
}

std::vector<RefinedKeyframe> refine_all(const std::vector<Given>& keyframes,
                                        const KeyframeWindowOptions& options) {
  KeyframeWindow window(kGrid, options);
  std::vector<RefinedKeyframe> result;
  for (const Given& keyframe : keyframes) {
    window.add(keyframe.frame, keyframe.map_T_camera);
    result = window.refine();
  }
  return result;
}

struct DepthError {
  double scale = 0;   // mean log ratio to the truth
  double smooth = 0;  // RMS about it
};
DepthError depth_error(const Plane<float>& depth, const Plane<float>& truth) {
  double sum = 0;
  double square = 0;
  for (std::size_t i = 0; i < depth.size(); ++i) {
    const double ratio = std::log(static_cast<double>(depth.values[i] / truth.values[i]));
    sum += ratio;
    square += ratio * ratio;
  }
  const auto count = static_cast<double>(depth.size());
  return {sum / count, std::sqrt(square / count - sum * sum / (count * count))};
}

// RMS of positions after the similarity that fits them best, and its scale.
struct PathError {
  double rms = 0;
  double scale = 1;
};
PathError path_error(const std::vector<SE3>& estimate, const std::vector<SE3>& truth) {
  Eigen::Matrix3Xd from(3, estimate.size());
  Eigen::Matrix3Xd to(3, estimate.size());
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    from.col(static_cast<Eigen::Index>(i)) = estimate[i].translation;
    to.col(static_cast<Eigen::Index>(i)) = truth[i].translation;
  }
  const Eigen::Matrix4d fit = Eigen::umeyama(from, to, true);
  const Eigen::Matrix3Xd off = (fit * from.colwise().homogeneous()).topRows<3>() - to;
  return {std::sqrt(off.squaredNorm() / static_cast<double>(estimate.size())),
          fit.topLeftCorner<3, 3>().col(0).norm()};
}

bool all_finite(const RefinedKeyframe& keyframe) {
  return keyframe.map_T_camera.matrix().allFinite() && keyframe.covariance.allFinite() &&
         std::isfinite(keyframe.relative_std) && std::isfinite(keyframe.scale);
}

class RefinedWindow : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    keyframes_ = new std::vector<Given>(given_keyframes(7));
    refined_ = new std::vector<RefinedKeyframe>(refine_all(*keyframes_, {}));
  }
  static void TearDownTestSuite() {
    delete keyframes_;
    delete refined_;
  }
  static const std::vector<Given>& keyframes() { return *keyframes_; }
  static const std::vector<RefinedKeyframe>& refined() { return *refined_; }

 private:
  static inline std::vector<Given>* keyframes_ = nullptr;
  static inline std::vector<RefinedKeyframe>* refined_ = nullptr;
};

TEST_F(RefinedWindow, PosesComeToSubpixelAgreement) {
  std::vector<SE3> before;
  std::vector<SE3> after;
  std::vector<SE3> truth;
  for (std::size_t k = 0; k < keyframes().size(); ++k) {
    before.push_back(keyframes()[k].map_T_camera);
    after.push_back(refined()[k].map_T_camera);
    truth.push_back(true_pose(static_cast<int>(k)));
  }
  const PathError start = path_error(before, truth);
  const PathError end = path_error(after, truth);
  // A pixel is 0.36 mm at the wall; patches without noise agree to a small part of it, but bilinear
  // interpolation and what the field cannot follow remain.
  constexpr double kLeastGain = 5;
  EXPECT_LT(end.rms, start.rms / kLeastGain);
}

TEST_F(RefinedWindow, ScaleIsTheMeanOfTheKeyframesOwn) {
  std::vector<SE3> after;
  std::vector<SE3> truth;
  double mean = 0;
  for (std::size_t k = 0; k < keyframes().size(); ++k) {
    after.push_back(refined()[k].map_T_camera);
    truth.push_back(true_pose(static_cast<int>(k)));
    mean += depth_error(keyframes()[k].frame.depth, keyframes()[k].true_depth).scale /
            static_cast<double>(keyframes().size());
  }
  // Each keyframe's scale was known to kScaleError, and there are seven.
  const double mean_std = kScaleError / std::sqrt(7.0);
  EXPECT_NEAR(std::log(path_error(after, truth).scale), -mean, mean_std);
  for (std::size_t k = 0; k < keyframes().size(); ++k) {
    EXPECT_NEAR(depth_error(refined()[k].depth, keyframes()[k].true_depth).scale, mean, mean_std);
  }
}

TEST_F(RefinedWindow, DepthsLoseTheirSmoothError) {
  constexpr double kLeastGain = 3;
  for (std::size_t k = 0; k < keyframes().size(); ++k) {
    const double before = depth_error(keyframes()[k].frame.depth, keyframes()[k].true_depth).smooth;
    const double after = depth_error(refined()[k].depth, keyframes()[k].true_depth).smooth;
    EXPECT_LT(after, before / kLeastGain) << k;
    EXPECT_LT(refined()[k].relative_std, kRelativeStd) << k;
    // Three of the sigmas that it says itself: the error is one draw of a few waves.
    EXPECT_LT(after, 3 * refined()[k].relative_std) << k;
  }
}

TEST_F(RefinedWindow, CovarianceCoversTheError) {
  const RefinedKeyframe& newest = refined().back();
  const SE3 truth = true_pose(static_cast<int>(keyframes().size()) - 1);
  const Vector6d off = (truth.inverse() * newest.map_T_camera).log();
  const double square = off.dot(newest.covariance.ldlt().solve(off));
  // 99.9 % of chi squared with six degrees of freedom.
  constexpr double kChi2 = 22.5;
  EXPECT_LT(square, kChi2);
  EXPECT_LT(std::sqrt(newest.covariance.topLeftCorner<3, 3>().trace()), kMillimetre);
}

TEST(KeyframeWindow, WhatLeftStillCounts) {
  const std::vector<Given> keyframes = given_keyframes(9);
  KeyframeWindowOptions all;
  all.keyframes = 9;
  KeyframeWindowOptions few;
  few.keyframes = 4;
  const RefinedKeyframe batch = refine_all(keyframes, all).back();
  const RefinedKeyframe kept = refine_all(keyframes, few).back();
  const Vector6d between = (batch.map_T_camera.inverse() * kept.map_T_camera).log();
  // The window saw less of the old keyframes, linearised where they were when they left; it must
  // agree within what it says it does not know.
  constexpr double kSigmas = 3;
  for (int i = 0; i < 6; ++i) {
    EXPECT_LT(std::fabs(between(i)), kSigmas * std::sqrt(kept.covariance(i, i))) << i;
    EXPECT_GT(kept.covariance(i, i), batch.covariance(i, i)) << i;
  }
  // Starting anew with the last four would be off by what tracking is off.
  const SE3 truth = true_pose(8);
  const double off = (kept.map_T_camera.translation - truth.translation).norm();
  const double start = (keyframes[8].map_T_camera.translation - truth.translation).norm();
  constexpr double kMeanScale = kScaleError / 2;  // nine keyframes: one more is large than small
  EXPECT_LT(off, start / 2 + kMeanScale * truth.translation.norm());
}

TEST(KeyframeWindow, WithoutTextureAllStaysAndIsSaidToBeUnknown) {
  const std::vector<Given> keyframes = given_keyframes(3, plain);
  KeyframeWindowOptions options;
  const std::vector<RefinedKeyframe> refined = refine_all(keyframes, options);
  constexpr double kNothing = 1e-9;
  for (std::size_t k = 0; k < keyframes.size(); ++k) {
    EXPECT_TRUE(all_finite(refined[k]));
    EXPECT_EQ(refined[k].points, 0);
    EXPECT_LT((keyframes[k].map_T_camera.inverse() * refined[k].map_T_camera).log().norm(),
              kNothing);
    EXPECT_EQ(refined[k].depth.values, keyframes[k].frame.depth.values);
    EXPECT_GE(refined[k].relative_std, kRelativeStd);
  }
  EXPECT_GE(std::sqrt(refined[1].covariance(0, 0)), options.pose_std * 0.9 * kDistance);
}

TEST(KeyframeWindow, PicturesWithoutAnythingDoNoHarm) {
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  for (const float depth : {0.0F, kNan, -1.0F, std::numeric_limits<float>::infinity()}) {
    KeyframeWindow window(kGrid, {});
    std::vector<RefinedKeyframe> refined;
    for (int k = 0; k < 9; ++k) {  // more than the window holds
      Given keyframe = given(k);
      if (k % 3 == 1)
        std::fill(keyframe.frame.depth.values.begin(), keyframe.frame.depth.values.end(), depth);
      if (k % 3 == 2)
        std::fill(keyframe.frame.albedo.values.begin(), keyframe.frame.albedo.values.end(), kNan);
      window.add(keyframe.frame, keyframe.map_T_camera);
      refined = window.refine();
    }
    for (const RefinedKeyframe& keyframe : refined) EXPECT_TRUE(all_finite(keyframe));
  }
}

TEST(KeyframeWindow, WhatHidesTheWallInOneKeyframeIsLeftOut) {
  std::vector<Given> keyframes = given_keyframes(5);
  const std::vector<RefinedKeyframe> clear = refine_all(keyframes, {});
  // A fold at half the distance over a third of the third picture, of other texture.
  Frame& frame = keyframes[2].frame;
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width / 3; ++u) {
      frame.depth.at(u, v) = static_cast<float>(kDistance / 2);
      frame.albedo.at(u, v) = static_cast<float>(vessels(1e-4 * u + 1, 1e-4 * v));
    }
  }
  const std::vector<RefinedKeyframe> hidden = refine_all(keyframes, {});
  constexpr double kSigmas = 4;
  for (std::size_t k = 1; k < keyframes.size(); ++k) {
    const Vector6d off = (clear[k].map_T_camera.inverse() * hidden[k].map_T_camera).log();
    for (int i = 0; i < 6; ++i) {
      EXPECT_LT(std::fabs(off(i)), kSigmas * std::sqrt(hidden[k].covariance(i, i)))
          << k << " " << i;
    }
  }
}

TEST(KeyframeWindow, PicturesOfOtherTissueShowInTheResiduals) {
  std::vector<Given> keyframes = given_keyframes(5);
  const double agreement = refine_all(keyframes, {}).back().rgb_rms;
  const auto elsewhere = [](double x, double y) { return vessels(y + 0.7, x - 0.3); };
  keyframes[4].frame.albedo = given(4, elsewhere).frame.albedo;
  // Residuals between pictures that have nothing in common are as large as their contrast.
  constexpr double kUnlike = 0.5;
  EXPECT_LT(agreement, kUnlike / 2);
  EXPECT_GT(refine_all(keyframes, {}).back().rgb_rms, kUnlike);
}

TEST(KeyframeWindow, ClearStartsAnew) {
  const std::vector<Given> keyframes = given_keyframes(4);
  KeyframeWindow window(kGrid, {});
  for (const Given& keyframe : keyframes) window.add(keyframe.frame, keyframe.map_T_camera);
  window.refine();
  window.clear();
  EXPECT_EQ(window.size(), 0U);
  EXPECT_TRUE(window.refine().empty());
  window.add(keyframes[2].frame, keyframes[2].map_T_camera);
  const std::vector<RefinedKeyframe> refined = window.refine();
  ASSERT_EQ(refined.size(), 1U);
  constexpr double kNothing = 1e-9;
  EXPECT_LT((keyframes[2].map_T_camera.inverse() * refined[0].map_T_camera).log().norm(), kNothing);
}

bool same_bytes(const std::vector<RefinedKeyframe>& a, const std::vector<RefinedKeyframe>& b) {
  if (a.size() != b.size()) return false;
  const auto same = [](const void* x, const void* y, std::size_t size) {
    return std::memcmp(x, y, size) == 0;
  };
  for (std::size_t k = 0; k < a.size(); ++k) {
    const Eigen::Matrix4d pose_a = a[k].map_T_camera.matrix();
    const Eigen::Matrix4d pose_b = b[k].map_T_camera.matrix();
    if (!same(pose_a.data(), pose_b.data(), sizeof pose_a) ||
        !same(a[k].covariance.data(), b[k].covariance.data(), sizeof a[k].covariance) ||
        !same(&a[k].relative_std, &b[k].relative_std, sizeof a[k].relative_std) ||
        !same(a[k].depth.values.data(), b[k].depth.values.data(), 4 * a[k].depth.size())) {
      return false;
    }
  }
  return true;
}

TEST(KeyframeWindow, SameBytesWhateverTheThreads) {
  const std::vector<Given> keyframes = given_keyframes(3);
  set_thread_count(1);
  const std::vector<RefinedKeyframe> one = refine_all(keyframes, {});
  set_thread_count(2);
  const std::vector<RefinedKeyframe> two = refine_all(keyframes, {});
  set_thread_count(0);
  EXPECT_TRUE(same_bytes(one, two));
}

TEST(KeyframeWindow, SameBytesOnEveryInstructionSet) {
  const std::vector<Given> keyframes = given_keyframes(3);
  const std::vector<RefinedKeyframe> best = refine_all(keyframes, {});
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    EXPECT_TRUE(same_bytes(best, refine_all(keyframes, {}))) << hwy::TargetName(target);
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

TEST(KeyframeWindow, RefusesNonsense) {
  KeyframeWindowOptions options;
  options.keyframes = 1;
  EXPECT_THROW(KeyframeWindow(kGrid, options), std::invalid_argument);
  KeyframeWindow window(kGrid, {});
  Frame frame = given(0).frame;
  frame.grid.width /= 2;
  EXPECT_THROW(window.add(frame, {}), std::invalid_argument);
}

// Refined in another frame and other metres it is what was refined, taken there.
TEST(KeyframeWindow, FrameAndMetresMakeNoDifference) {
  constexpr int kKeyframes = 9;  // the oldest have left
  constexpr int kMoved = 6;      // keyframes are there when it moves
  const Similarity similarity{1.1, so3_exp({0.5, -1, 2}), {0.1, 0.2, -0.3}};
  KeyframeWindow still(kGrid, {});
  KeyframeWindow moved(kGrid, {});
  std::vector<RefinedKeyframe> expected;
  std::vector<RefinedKeyframe> refined;
  for (int k = 0; k < kKeyframes; ++k) {
    Frame frame = true_frame(true_pose(k), k);
    spoil_depth(1, static_cast<std::uint64_t>(k), frame);
    const SE3 pose = true_pose(k) * SE3::exp(tracking_error(k));
    still.add(frame, pose);
    expected = still.refine();
    if (k == kMoved) moved.transform(similarity);
    const bool is_there = k >= kMoved;
    if (is_there) {
      for (float& depth : frame.depth.values) depth *= static_cast<float>(similarity.scale);
    }
    moved.add(frame, is_there ? similarity * pose : pose);
    refined = moved.refine();
  }
  ASSERT_EQ(refined.size(), expected.size());
  constexpr double kRounding = 1e-3;  // of a tracking error: sums of floats
  constexpr double kShare = 1e-2;
  for (std::size_t k = 0; k < refined.size(); ++k) {
    const SE3 there = similarity * expected[k].map_T_camera;
    EXPECT_LT((refined[k].map_T_camera.translation - there.translation).norm(),
              kRounding * kTrackingError);
    EXPECT_LT(angle_between(refined[k].map_T_camera.rotation, there.rotation),
              kRounding * kTrackingTurn);
    const auto factors = similarity.twist_factors();
    const Matrix6d covariance =
        factors.asDiagonal() * expected[k].covariance * factors.asDiagonal();
    EXPECT_LT((refined[k].covariance - covariance).norm(), kShare * covariance.norm());
    EXPECT_EQ(refined[k].points, expected[k].points);
  }
}

}  // namespace
}  // namespace gastronaut::slam

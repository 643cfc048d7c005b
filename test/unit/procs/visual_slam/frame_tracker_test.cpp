#include "visual_slam/frame_tracker.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <hwy/highway.h>

#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <stdexcept>

#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut::slam {
namespace {

using ::testing::HasSubstr;

constexpr double kMillimetre = 1e-3;
constexpr double kDegree = M_PI / 180;
// A capsule's camera at tracking resolution.
const PinholeGrid kGrid{320, 240, 166.4, 166.4, 160.9, 118.9};
const PinholeGrid kSmallGrid = kGrid.coarser(2);

// A surface that is where `outside` is zero; the camera is where it is negative.
struct Scene {
  std::function<double(const Eigen::Vector3d&)> outside;
  std::function<double(const Eigen::Vector3d&)> albedo;
};

double plain(const Eigen::Vector3d&) { return 0.5; }

// Waves of 5 to 12 mm, like folds and vessels.
double speckled(const Eigen::Vector3d& p) {
  return 0.5 + 0.08 * std::sin(900 * p.x() + 300 * p.y()) * std::cos(700 * p.y() - 200 * p.z()) +
         0.06 * std::sin(500 * p.x() - 1100 * p.y() + 1);
}

// 30 mm in front of the map's origin; slopes up to 0.4.
double bumpy_wall(const Eigen::Vector3d& p) {
  return p.z() - 0.03 - 1e-3 * std::sin(250 * p.x() + 0.5) * std::cos(200 * p.y()) -
         0.5e-3 * std::sin(310 * p.y() + 200 * p.x());
}
double flat_wall(const Eigen::Vector3d& p) { return p.z() - 0.03; }
double tube(const Eigen::Vector3d& p) { return p.head<2>().norm() - 0.015; }

struct Hit {
  float depth;
  Eigen::Vector3f normal;  // towards the camera
  float albedo;
};

// Newton's method along the ray.
Hit look(const Scene& scene, const SE3& map_T_camera, const Eigen::Vector3d& ray) {
  constexpr double kFarthest = 0.1;  // metres
  constexpr double kStep = 1e-6;
  constexpr double kExact = 1e-9;
  const Eigen::Vector3d way = map_T_camera.rotation * ray;
  double depth = 0.02;
  for (int i = 0; i < 30; ++i) {
    const double value = scene.outside(map_T_camera.translation + depth * way);
    if (std::fabs(value) < kExact) break;
    const double next = scene.outside(map_T_camera.translation + (depth + kStep) * way);
    depth -= value * kStep / (next - value);
    if (!(depth > 0 && depth < kFarthest)) return {0, Eigen::Vector3f::Zero(), -1};
  }
  const Eigen::Vector3d point = map_T_camera.translation + depth * way;
  Eigen::Vector3d gradient;
  for (int i = 0; i < 3; ++i) {
    const Eigen::Vector3d shift = kStep * Eigen::Vector3d::Unit(i);
    gradient(i) = scene.outside(point + shift) - scene.outside(point - shift);
  }
  const Eigen::Vector3d normal = map_T_camera.rotation.inverse() * -gradient.normalized();
  return {static_cast<float>(depth), normal.cast<float>(), static_cast<float>(scene.albedo(point))};
}

ModelView model_view(const Scene& scene, const SE3& map_T_camera, const PinholeGrid& grid) {
  const Plane<float> empty(grid.width, grid.height);
  ModelView view{map_T_camera, grid, empty, empty, empty, empty, empty, empty, {}};
  view.surfel = Plane<std::int32_t>(grid.width, grid.height);
  for (int v = 0; v < grid.height; ++v) {
    for (int u = 0; u < grid.width; ++u) {
      const Hit hit =
          look(scene, map_T_camera, {(u - grid.cx) / grid.fx, (v - grid.cy) / grid.fy, 1});
      view.depth.at(u, v) = hit.depth;
      view.normal_x.at(u, v) = hit.normal.x();
      view.normal_y.at(u, v) = hit.normal.y();
      view.normal_z.at(u, v) = hit.normal.z();
      view.albedo.at(u, v) = hit.albedo;
    }
  }
  return view;
}

Frame frame_of(const ModelView& view) { return {0, view.grid, view.depth, view.albedo, 0}; }
Frame frame_of(const Scene& scene, const SE3& map_T_camera, const PinholeGrid& grid) {
  return frame_of(model_view(scene, map_T_camera, grid));
}

void add_noise(double depth_std, double albedo_std, std::uint64_t seed, Frame& frame) {
  const CounterRandom random(seed, 0);
  for (std::size_t i = 0; i < frame.depth.size(); ++i) {
    const auto [a, b] = random.normal_pair(i);
    frame.depth.values[i] *= static_cast<float>(1 + depth_std * a);
    frame.albedo.values[i] += static_cast<float>(albedo_std * b);
  }
}

SE3 moved(double millimetres, double degrees) {
  Vector6d twist;
  twist.head<3>() = Eigen::Vector3d(0.6, -0.64, 0.48) * (millimetres * kMillimetre);
  twist.tail<3>() = Eigen::Vector3d(0.48, 0.6, -0.64) * (degrees * kDegree);
  return SE3::exp(twist);
}

const Scene kTextured{bumpy_wall, speckled};

void expect_at(const SE3& estimate, const SE3& truth, double metres, double radians) {
  EXPECT_LT((estimate.translation - truth.translation).norm(), metres);
  EXPECT_LT(angle_between(estimate.rotation, truth.rotation), radians);
}

// What is asked for with true depth: a tenth of a pixel is 0.018 mm at 30 mm.
constexpr double kExactMetres = 0.02 * kMillimetre;
constexpr double kExactRadians = 0.02 * kDegree;

TEST(FrameTracker, RecoversASmallMotion) {
  const ModelView model = model_view(kTextured, {}, kGrid);
  const SE3 truth = moved(0.8, 1);
  const TrackingResult result =
      FrameTracker(kGrid, {}).track(frame_of(kTextured, truth, kGrid), model, {});
  EXPECT_EQ(result.status, TrackingStatus::kOk) << result.cause;
  expect_at(result.map_T_camera, truth, kExactMetres, kExactRadians);
}

TEST(FrameTracker, RecoversASmallMotionByDepthAlone) {
  const Scene scene{bumpy_wall, plain};
  const ModelView model = model_view(scene, {}, kGrid);
  const SE3 truth = moved(0.8, 1);
  TrackerOptions options;
  options.rgb_weight = 0;
  const TrackingResult result =
      FrameTracker(kGrid, options).track(frame_of(scene, truth, kGrid), model, {});
  EXPECT_EQ(result.status, TrackingStatus::kOk) << result.cause;
  expect_at(result.map_T_camera, truth, kExactMetres, kExactRadians);
}

TEST(FrameTracker, RecoversASmallMotionByColourAlone) {
  const ModelView model = model_view(kTextured, {}, kGrid);
  const SE3 truth = moved(0.8, 1);
  Frame frame = frame_of(kTextured, truth, kGrid);
  frame.depth.values.assign(frame.depth.size(), 0);
  TrackerOptions options;
  options.icp_weight = 0;
  const TrackingResult result = FrameTracker(kGrid, options).track(frame, model, {});
  EXPECT_EQ(result.status, TrackingStatus::kOk) << result.cause;
  expect_at(result.map_T_camera, truth, kExactMetres, kExactRadians);
}

TEST(FrameTracker, ConvergesFromAWrongStart) {
  const ModelView model = model_view(kTextured, {}, kGrid);
  const SE3 truth = moved(2, 2);
  const TrackingResult result =
      FrameTracker(kGrid, {}).track(frame_of(kTextured, truth, kGrid), model, {});
  EXPECT_EQ(result.status, TrackingStatus::kOk) << result.cause;
  expect_at(result.map_T_camera, truth, kExactMetres, kExactRadians);
}

// The lamp's exposure and the albedo's unit are nobody's business.
TEST(FrameTracker, DoesNotCareForTheAlbedosUnit) {
  const ModelView model = model_view(kTextured, {}, kSmallGrid);
  const SE3 truth = moved(0.8, 1);
  Frame frame = frame_of(kTextured, truth, kSmallGrid);
  for (float& albedo : frame.albedo.values) albedo *= 0.6F;
  const TrackingResult result = FrameTracker(kSmallGrid, {}).track(frame, model, {});
  EXPECT_EQ(result.status, TrackingStatus::kOk) << result.cause;
  expect_at(result.map_T_camera, truth, 2 * kExactMetres, 2 * kExactRadians);  // coarser pixels
}

TEST(FrameTracker, FindsTheDepthsCommonScaleFromColour) {
  constexpr double kScale = 1.04;  // as depth from shading is wrong
  constexpr double kScaleTolerance = 5e-3;
  constexpr double kMetres = 0.1 * kMillimetre;
  const ModelView model = model_view(kTextured, {}, kGrid);
  const SE3 truth = moved(0.8, 1);
  Frame frame = frame_of(kTextured, truth, kGrid);
  for (float& depth : frame.depth.values) depth *= static_cast<float>(kScale);
  frame.relative_std = 0.05;
  const TrackingResult result = FrameTracker(kGrid, {}).track(frame, model, {});
  EXPECT_EQ(result.status, TrackingStatus::kOk) << result.cause;
  EXPECT_NEAR(result.depth_scale, 1 / kScale, kScaleTolerance);
  EXPECT_LT((result.map_T_camera.translation - truth.translation).norm(), kMetres);
}

TEST(FrameTracker, PlainWallHoldsNothingAlongItself) {
  const Scene scene{flat_wall, plain};
  const ModelView model = model_view(scene, {}, kGrid);
  Frame frame = frame_of(scene, moved(0.3, 0), kGrid);
  add_noise(0.002, 0.005, 1, frame);
  const TrackingResult result = FrameTracker(kGrid, {}).track(frame, model, {});
  EXPECT_EQ(result.status, TrackingStatus::kDegraded);
  EXPECT_THAT(result.cause, HasSubstr("no hold along"));
  EXPECT_THAT(result.cause, HasSubstr("no hold in rotation about the camera's z axis"));
  // Across the wall it holds: a hundredth of the distance is what OK asks for.
  const double along = std::sqrt(result.covariance(0, 0));
  const double across = std::sqrt(result.covariance(2, 2));
  EXPECT_GT(along, 0.01 * 0.03);
  EXPECT_LT(across, 0.01 * 0.03);
  EXPECT_NEAR(result.map_T_camera.translation.z(), moved(0.3, 0).translation.z(), kExactMetres);
}

// A map's own noise looks like relief and texture; neither is in the frame.
TEST(FrameTracker, NoiseOfTheMapIsNoHold) {
  const Scene scene{flat_wall, plain};
  ModelView model = model_view(scene, {}, kGrid);
  const CounterRandom random(5, 0);
  for (std::size_t i = 0; i < model.depth.size(); ++i) {
    const auto [x, y] = random.normal_pair(2 * i);
    const auto [albedo, depth] = random.normal_pair(2 * i + 1);
    model.normal_x.values[i] += static_cast<float>(0.02 * x);
    model.normal_y.values[i] += static_cast<float>(0.02 * y);
    model.albedo.values[i] += static_cast<float>(0.005 * albedo);
    model.depth.values[i] *= static_cast<float>(1 + 0.001 * depth);
  }
  Frame frame = frame_of(scene, moved(0.3, 0), kGrid);
  add_noise(0.002, 0.005, 1, frame);
  const TrackingResult result = FrameTracker(kGrid, {}).track(frame, model, {});
  EXPECT_EQ(result.status, TrackingStatus::kDegraded);
  EXPECT_THAT(result.cause, HasSubstr("no hold in rotation about the camera's z axis"));
}

TEST(FrameTracker, PlainTubeHoldsNothingAlongItsAxis) {
  const Scene scene{tube, plain};
  const ModelView model = model_view(scene, {}, kGrid);
  Frame frame = frame_of(scene, moved(0.3, 0), kGrid);
  add_noise(0.002, 0.005, 1, frame);
  const TrackingResult result = FrameTracker(kGrid, {}).track(frame, model, {});
  EXPECT_EQ(result.status, TrackingStatus::kDegraded);
  EXPECT_THAT(result.cause, HasSubstr("no hold along the camera's z axis"));
}

TEST(FrameTracker, SaysWhyItIsLost) {
  const ModelView model = model_view(kTextured, {}, kSmallGrid);
  const Frame frame = frame_of(model);
  const SE3 start = moved(0.5, 0.5);
  FrameTracker tracker(kSmallGrid, {});

  ModelView nothing = model;
  nothing.depth.values.assign(nothing.depth.size(), 0);
  TrackingResult result = tracker.track(frame, nothing, start);
  EXPECT_EQ(result.status, TrackingStatus::kLost);
  EXPECT_THAT(result.cause, HasSubstr("the map shows something"));
  EXPECT_EQ(result.map_T_camera.translation, start.translation);

  Frame dark = frame;
  dark.depth.values.assign(dark.depth.size(), std::numeric_limits<float>::quiet_NaN());
  dark.albedo.values.assign(dark.albedo.size(), -1);
  result = tracker.track(dark, model, start);
  EXPECT_EQ(result.status, TrackingStatus::kLost);
  EXPECT_THAT(result.cause, HasSubstr("neither depth nor albedo"));

  Frame elsewhere = frame;
  for (float& depth : elsewhere.depth.values) depth *= 2;
  result = tracker.track(elsewhere, model, start);
  EXPECT_EQ(result.status, TrackingStatus::kLost);
  EXPECT_FALSE(result.cause.empty());
  EXPECT_EQ(result.map_T_camera.translation, start.translation);
}

TEST(FrameTracker, OtherTissueAtTheSameDistanceIsLost) {
  const auto elsewhere = [](const Eigen::Vector3d& p) -> Eigen::Vector3d {
    return {0.041 - 1.3 * p.y(), 0.7 * p.x() - 0.053, p.z()};
  };
  const Scene other{[&](const Eigen::Vector3d& p) { return bumpy_wall(elsewhere(p)); },
                    [&](const Eigen::Vector3d& p) { return speckled(elsewhere(p)); }};
  const ModelView model = model_view(kTextured, {}, kSmallGrid);
  const TrackingResult result =
      FrameTracker(kSmallGrid, {}).track(frame_of(other, {}, kSmallGrid), model, {});
  EXPECT_EQ(result.status, TrackingStatus::kLost);
  EXPECT_THAT(result.cause, HasSubstr("does not look like the map"));
}

TEST(FrameTracker, SurvivesHolesOfNaN) {
  const ModelView model = model_view(kTextured, {}, kGrid);
  const SE3 truth = moved(0.8, 1);
  Frame frame = frame_of(kTextured, truth, kGrid);
  const CounterRandom random(3, 0);
  for (std::size_t i = 0; i < frame.depth.size(); ++i) {
    if (random.uniform(i) < 0.1) frame.depth.values[i] = std::numeric_limits<float>::quiet_NaN();
    if (i % 7 == 0) frame.depth.values[i] = std::numeric_limits<float>::infinity();
  }
  for (int v = 40; v < 120; ++v) {
    for (int u = 40; u < 120; ++u) {
      frame.albedo.at(u, v) = std::numeric_limits<float>::quiet_NaN();
    }
  }
  const TrackingResult result = FrameTracker(kGrid, {}).track(frame, model, {});
  EXPECT_NE(result.status, TrackingStatus::kLost) << result.cause;
  expect_at(result.map_T_camera, truth, kExactMetres, kExactRadians);
}

TEST(FrameTracker, CovarianceIsThatOfTheErrors) {
  // Six unknowns: errors squared over the covariance are 6 in the mean. Weights that are not
  // inverse variances, Cauchy's losses and the scatter of a mean over these runs are allowed for.
  constexpr int kRuns = 30;
  constexpr double kLeast = 6.0 / 3;
  constexpr double kMost = 6.0 * 1.5;
  const ModelView model = model_view(kTextured, {}, kSmallGrid);
  const SE3 truth = moved(0.5, 0.7);
  const Frame clean = frame_of(kTextured, truth, kSmallGrid);
  TrackerOptions options;
  options.misregistration = 0;  // the scene has no lamp that could leave anything
  FrameTracker tracker(kSmallGrid, options);
  double sum = 0;
  for (int run = 0; run < kRuns; ++run) {
    Frame frame = clean;
    add_noise(0.01, 0.02, static_cast<std::uint64_t>(run), frame);
    const TrackingResult result = tracker.track(frame, model, {});
    ASSERT_EQ(result.status, TrackingStatus::kOk) << result.cause;
    const Vector6d error = (result.map_T_camera.inverse() * truth).log();
    sum += error.dot(result.covariance.ldlt().solve(error));
  }
  EXPECT_GT(sum / kRuns, kLeast);
  EXPECT_LT(sum / kRuns, kMost);
}

bool same_bytes(const TrackingResult& a, const TrackingResult& b) {
  return a.map_T_camera.matrix() == b.map_T_camera.matrix() && a.covariance == b.covariance &&
         a.icp_rms == b.icp_rms && a.rgb_rms == b.rgb_rms &&
         a.inlier_fraction == b.inlier_fraction && a.depth_scale == b.depth_scale;
}

TEST(FrameTracker, SameBytesOnAnyNumberOfThreads) {
  const ModelView model = model_view(kTextured, {}, kGrid);
  const Frame frame = frame_of(kTextured, moved(0.8, 1), kGrid);
  set_thread_count(1);
  const TrackingResult one = FrameTracker(kGrid, {}).track(frame, model, {});
  set_thread_count(4);
  const TrackingResult four = FrameTracker(kGrid, {}).track(frame, model, {});
  set_thread_count(0);
  EXPECT_TRUE(same_bytes(one, four));
}

TEST(FrameTracker, SameBytesOnEveryInstructionSet) {
  const ModelView model = model_view(kTextured, {}, kSmallGrid);
  const Frame frame = frame_of(kTextured, moved(0.8, 1), kSmallGrid);
  const TrackingResult best = FrameTracker(kSmallGrid, {}).track(frame, model, {});
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    const TrackingResult result = FrameTracker(kSmallGrid, {}).track(frame, model, {});
    EXPECT_TRUE(same_bytes(best, result)) << hwy::TargetName(target);
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

TEST(FrameTracker, RefusesAnotherGrid) {
  EXPECT_THROW(FrameTracker(kGrid.coarser(20), {}), std::invalid_argument);
  const ModelView model = model_view(kTextured, {}, kSmallGrid);
  EXPECT_THROW(FrameTracker(kGrid, {}).track(frame_of(model), model, {}), std::invalid_argument);
}

}  // namespace
}  // namespace gastronaut::slam

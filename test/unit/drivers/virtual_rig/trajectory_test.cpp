#include "virtual_rig/trajectory.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <numbers>

#include "small_scenario.hpp"
#include "virtual_rig/organ.hpp"

namespace gastronaut {
namespace {

const std::string kScenarios = std::string(GASTRONAUT_SOURCE_DIR) + "/config/scenarios/";

double travelled(const Trajectory& trajectory, double seconds) {
  constexpr int kSteps = 20000;
  double length = 0;
  for (int i = 0; i < kSteps; ++i) {
    length += (trajectory.pose(seconds * (i + 1) / kSteps)->translation -
               trajectory.pose(seconds * i / kSteps)->translation)
                  .norm();
  }
  return length;
}

TEST(Trajectory, TourHasTheLengthThatWasAskedFor) {
  constexpr double kPolyline = 1e-4;  // relative, of summing straight steps
  VirtualRigScenario scenario = small_scenario();
  const Organ organ(scenario.organ);
  for (const double length : {0.05, 0.20, 1.0}) {
    for (const bool returns : {true, false}) {
      scenario.trajectory.path_length = length;
      scenario.trajectory.returns = returns;
      const Trajectory trajectory(scenario.trajectory, organ.centreline(), SE3(), scenario.seed);
      EXPECT_NEAR(travelled(trajectory, scenario.trajectory.period), length, kPolyline * length);
    }
  }
}

TEST(Trajectory, TourThatReturnsEndsWhereItBegan) {
  const VirtualRigScenario scenario = small_scenario();
  const Organ organ(scenario.organ);
  const Trajectory trajectory(scenario.trajectory, organ.centreline(), SE3(), scenario.seed);
  constexpr double kRounding = 1e-9;
  EXPECT_LT(
      (trajectory.pose(0)->inverse() * *trajectory.pose(scenario.trajectory.period)).log().norm(),
      kRounding);
}

TEST(Trajectory, EveryStomachsTourKeepsClearOfTheWallAndLooksAtIt) {
  constexpr double kClear = 0.008;  // metres: a capsule's radius and some air
  constexpr double kNearest = 0.015;
  constexpr double kFurthest = 0.06;
  constexpr double kBesideRay = 0.003;  // metres: coarse meshes have a vertex that near every ray
  for (const char* name : {"st0", "st1", "st2", "st3", "fast", "peristalsis"}) {
    const VirtualRigScenario scenario =
        load_scenario(kScenarios + name + ".yaml", {"organ.edge=2mm"});
    const Organ organ(scenario.organ);
    const Trajectory trajectory(scenario.trajectory, organ.centreline(), SE3(), scenario.seed);
    constexpr int kPoses = 60;
    for (int i = 0; i < kPoses; ++i) {
      const SE3 pose = *trajectory.pose(scenario.trajectory.period * i / kPoses);
      const SE3 camera_T_rig = pose.inverse();
      double clear = 1;
      double ahead = 1;
      for (const Eigen::Vector3f& vertex : organ.rest().vertices) {
        const Eigen::Vector3d seen = camera_T_rig * vertex.cast<double>();
        clear = std::min(clear, seen.norm());
        if (seen.z() > 0 && seen.head<2>().norm() < kBesideRay) ahead = std::min(ahead, seen.z());
      }
      EXPECT_GT(clear, kClear) << name << " pose " << i;
      EXPECT_GT(ahead, kNearest) << name << " pose " << i;
      EXPECT_LT(ahead, kFurthest) << name << " pose " << i;
    }
  }
}

TEST(Trajectory, MovesSmoothly) {
  const VirtualRigScenario scenario = small_scenario();
  const Organ organ(scenario.organ);
  const Trajectory trajectory(scenario.trajectory, organ.centreline(), SE3(), scenario.seed);
  // Second differences of a smooth path fall with the square of the step.
  const auto bend = [&](double time, double step) {
    return (trajectory.pose(time + step)->translation - 2 * trajectory.pose(time)->translation +
            trajectory.pose(time - step)->translation)
        .norm();
  };
  constexpr double kJerkLeaves = 0.3;  // against a quarter
  for (double time = 0.5; time < 19; time += 0.37) {
    EXPECT_LT(bend(time, 0.01), kJerkLeaves * bend(time, 0.02) + 1e-9) << time;
  }
}

TEST(Trajectory, AbsentCapsuleHasNoPoseAndStaticOneStays) {
  VirtualRigScenario scenario = small_scenario();
  const Organ organ(scenario.organ);
  scenario.trajectory.kind = TrajectoryKind::kAbsent;
  EXPECT_FALSE(Trajectory(scenario.trajectory, organ.centreline(), SE3(), 1).pose(3));
  scenario.trajectory.kind = TrajectoryKind::kStatic;
  const Trajectory rests(scenario.trajectory, organ.centreline(), SE3(), 1);
  EXPECT_EQ(rests.pose(0)->matrix(), rests.pose(17)->matrix());
}

TEST(Trajectory, ArrayCalibrationRestsAtPlacesInItsBox) {
  VirtualRigScenario scenario = small_scenario();
  TrajectoryConfiguration& walk = scenario.trajectory;
  walk.kind = TrajectoryKind::kArrayCalibration;
  const Organ organ(scenario.organ);
  const SE3 camera_T_magnet = SE3::exp((Vector6d() << 0, 0, -0.009, 0.1, 0, 0).finished());
  const Trajectory trajectory(walk, organ.centreline(), camera_T_magnet, 1);
  constexpr double kRounding = 1e-12;
  for (int i = 0; i < 20; ++i) {
    const SE3 early = *trajectory.pose(i * walk.dwell) * camera_T_magnet;
    const SE3 later = *trajectory.pose((i + 0.4) * walk.dwell) * camera_T_magnet;
    EXPECT_LT((early.matrix() - later.matrix()).norm(), kRounding);
    EXPECT_TRUE(((early.translation - walk.box_centre).cwiseAbs().array() <=
                 walk.box_half_size.array() + kRounding)
                    .all());
  }
}

TEST(Trajectory, RefusesATourThatDoesNotFit) {
  VirtualRigScenario scenario = small_scenario();
  scenario.trajectory.path_length = 1000;
  const Organ organ(scenario.organ);
  EXPECT_THROW(Trajectory(scenario.trajectory, organ.centreline(), SE3(), 1), ConfigurationError);
}

TEST(Trajectory, LightCalibrationLooksAtTheCardsMiddleFromNearAndFarAndAslant) {
  const VirtualRigScenario scenario = load_scenario(kScenarios + "light_calibration.yaml", {});
  const Organ card(scenario.organ);
  const Trajectory trajectory(scenario.trajectory, card.centreline(), SE3(), scenario.seed);
  double nearest = 1;
  double furthest = 0;
  double steepest = 0;
  constexpr int kPoses = 500;
  for (int i = 0; i < kPoses; ++i) {
    const SE3 rig_T_camera = *trajectory.pose(scenario.trajectory.period * i / kPoses);
    const double distance = rig_T_camera.translation.norm();  // the card's middle is the origin
    constexpr double kRounding = 1e-9;
    EXPECT_LT((rig_T_camera * Eigen::Vector3d(0, 0, distance)).norm(), kRounding);
    EXPECT_GT(rig_T_camera.translation.z(), 0) << "before the card";
    nearest = std::min(nearest, distance);
    furthest = std::max(furthest, distance);
    steepest = std::max(steepest, std::acos(rig_T_camera.translation.z() / distance));
  }
  constexpr double kSampled = 0.01;  // relative
  EXPECT_NEAR(nearest, scenario.trajectory.nearest, kSampled * nearest);
  EXPECT_NEAR(furthest, scenario.trajectory.furthest, kSampled * furthest);
  EXPECT_GT(steepest, scenario.trajectory.tilt / 2);
  EXPECT_LT(steepest, std::numbers::sqrt2 * scenario.trajectory.tilt);
}

}  // namespace
}  // namespace gastronaut

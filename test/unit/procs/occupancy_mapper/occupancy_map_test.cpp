#include "occupancy_mapper/occupancy_map.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "numerics/counter_random.hpp"
#include "unit/procs/occupancy_mapper/occupancy_scene.hpp"

namespace gastronaut::occupancy {
namespace {

enum class Space { kUnknown, kFree, kOccupied };

Space at(const OccupancyMap& map, const Eigen::Vector3d& position) {
  const VoxelIndex voxel = map.voxel_of(position).value();
  if (map.space().is_occupied(voxel)) return Space::kOccupied;
  return map.space().is_free(voxel) ? Space::kFree : Space::kUnknown;
}

Eigen::Vector3d random_direction(const CounterRandom& random, std::uint64_t number) {
  const auto [x, y] = random.normal_pair(2 * number);
  return Eigen::Vector3d(x, y, random.normal(2 * number + 1)).normalized();
}

class OccupancyMapTest : public ::testing::Test {
 protected:
  std::int64_t look_around_from(const Eigen::Vector3d& position, int map_version = 0) {
    return utime_ = look_around(map_, position, utime_, map_version);
  }
  void apply(const std::vector<MapSurfel>& surfels) { map_.apply(change_of(surfels, utime_)); }
  // Nothing is left that would stay for ever.
  void expect_nothing_known() {
    EXPECT_EQ(map_.tree().size(), 0U);
    EXPECT_EQ(map_.space().size(), 0U);
  }

  OccupancyMap map_{scene_options()};
  std::int64_t utime_ = 0;
};

TEST_F(OccupancyMapTest, SphereIsAShellFreeInsideAndUnknownOutside) {
  constexpr double kRadius = 0.02;
  constexpr std::uint64_t kSamples = 20000;
  look_around_from(Eigen::Vector3d::Zero());
  const std::vector<MapSurfel> wall = sphere(kRadius);
  apply(wall);
  for (const MapSurfel& each : wall) {
    ASSERT_EQ(at(map_, each.position.cast<double>()), Space::kOccupied);
  }
  const CounterRandom random(1, 0);
  for (std::uint64_t i = 0; i < kSamples; ++i) {
    const Eigen::Vector3d direction = random_direction(random, i);
    // A voxel that holds a point of the wall reaches no farther than its diagonal.
    const double inside = (kRadius - kDiagonal) * random.uniform(4 * kSamples + i);
    EXPECT_EQ(at(map_, inside * direction), Space::kFree) << inside;
    const double outside = kRadius + kDiagonal + kRadius * random.uniform(5 * kSamples + i);
    EXPECT_EQ(at(map_, outside * direction), Space::kUnknown) << outside;
  }
  // The nearest voxel is no nearer than its diagonal allows.
  EXPECT_LE(map_.clearance().value(), kRadius);
  EXPECT_GE(map_.clearance().value(), kRadius - kDiagonal);
  // A closed wall has no opening.
  EXPECT_EQ(map_.coverage().value(), 1);
}

TEST_F(OccupancyMapTest, CoverageOfATubeIsItsWallBesideTheOpeningsToBothSides) {
  constexpr double kRadius = 0.04;
  constexpr double kHalfLength = 0.06;
  look_around_from(Eigen::Vector3d::Zero());
  apply(tube(kRadius, kHalfLength));
  // Seen from the middle, each end is a cone with its tip there. The area of a surface in faces
  // along the axes: a tube has 8 r a length (the square around a circle), a cone the integral of
  // that and its base.
  const double wall = 8 * kRadius * 2 * kHalfLength;
  const double cone = std::numbers::pi * kRadius * kRadius + 4 * kRadius * kHalfLength;
  // Faces are blocks' (a tenth of the radius), and those before the wall lie inside of it.
  constexpr double kTolerance = 0.03;
  EXPECT_NEAR(map_.coverage().value(), wall / (wall + 2 * cone), kTolerance);
}

TEST_F(OccupancyMapTest, ClearanceIsToTheNearestWallFromTheNewestPose) {
  constexpr double kDistance = 0.0305;  // middle of a voxel: its face is at 30 mm
  constexpr double kStep = 0.01;
  constexpr double kRounding = 1e-9;
  EXPECT_FALSE(map_.clearance().has_value());
  look_around_from(Eigen::Vector3d::Zero());
  apply(plate(kDistance, kBlock));
  EXPECT_NEAR(map_.clearance().value(), 0.030, kRounding);
  look_around_from({0, 0, kStep});
  EXPECT_NEAR(map_.clearance().value(), 0.030 - kStep, kRounding);
  // When tracking is lost it is not told for long.
  constexpr std::int64_t kLater = 3'000'000;  // microseconds, beyond pose_age
  map_.apply(change_of({}, utime_ + kLater));
  EXPECT_FALSE(map_.clearance().has_value());
  // A pose of the map's next version is in another frame, as long as the map is not there.
  look_around_from(Eigen::Vector3d::Zero(), 1);
  EXPECT_FALSE(map_.clearance().has_value());
}

TEST_F(OccupancyMapTest, WallThatMovesTakesItsVoxelsAndItsFreeSpaceAlong) {
  constexpr double kNear = 0.0205;
  constexpr double kFar = 0.0405;
  constexpr double kHalfSide = 0.01;
  const Eigen::Vector3d near_wall(0.3e-3, 0.3e-3, kNear);
  const Eigen::Vector3d far_wall(0.3e-3, 0.3e-3, kFar);
  const Eigen::Vector3d between(0.3e-3, 0.3e-3, 0.0305);
  look_around_from(Eigen::Vector3d::Zero());
  apply(plate(kNear, kHalfSide));
  EXPECT_EQ(at(map_, near_wall), Space::kOccupied);
  EXPECT_EQ(at(map_, between), Space::kUnknown);
  apply(plate(kFar, kHalfSide));
  EXPECT_EQ(at(map_, near_wall), Space::kFree);
  EXPECT_EQ(at(map_, between), Space::kFree);
  EXPECT_EQ(at(map_, far_wall), Space::kOccupied);
  apply(plate(kNear, kHalfSide));
  EXPECT_EQ(at(map_, near_wall), Space::kOccupied);
  EXPECT_EQ(at(map_, between), Space::kUnknown);
  EXPECT_EQ(at(map_, far_wall), Space::kUnknown);
}

TEST_F(OccupancyMapTest, AVoxelIsOccupiedUntilItsLastSurfelHasLeft) {
  const Eigen::Vector3d place(0.5e-3, 0.5e-3, 0.0205);
  const Eigen::Vector3d normal = -Eigen::Vector3d::UnitZ();
  look_around_from(Eigen::Vector3d::Zero());
  apply({surfel(7, place, normal), surfel(8, place, normal)});
  MapChange change = change_of({}, utime_);
  change.removed = {7};
  map_.apply(change);
  EXPECT_EQ(at(map_, place), Space::kOccupied);
  // One that is no longer stable is no wall either.
  MapSurfel faint = surfel(8, place, normal);
  faint.is_stable = false;
  apply({faint});
  EXPECT_EQ(at(map_, place), Space::kUnknown);
  expect_nothing_known();
}

TEST_F(OccupancyMapTest, OneLineOfSightAVoxelWhoeverSeesIt) {
  const Eigen::Vector3d wall(0.5e-3, 0.5e-3, 0.0405);
  const Eigen::Vector3d normal = -Eigen::Vector3d::UnitZ();
  const Eigen::Vector3d second(0.02, 0, 0);
  look_around_from(Eigen::Vector3d::Zero());
  apply({surfel(0, wall, normal)});
  EXPECT_EQ(at(map_, wall / 2), Space::kFree);
  look_around_from(second);
  apply({surfel(1, wall, normal), surfel(0, wall, normal)});
  EXPECT_EQ(at(map_, (wall + second) / 2), Space::kUnknown);
  // What the one surfel saw lasts as long as the voxel does.
  MapChange change = change_of({}, utime_);
  change.removed = {0};
  map_.apply(change);
  EXPECT_EQ(at(map_, wall / 2), Space::kFree);
  change.removed = {1};
  map_.apply(change);
  expect_nothing_known();
}

TEST_F(OccupancyMapTest, WallThatNoPoseSeesHasNoFreeSpaceUntilOneDoes) {
  const Eigen::Vector3d wall(0, 0, 0.0405);
  const MapSurfel seen_from_behind = surfel(0, wall, Eigen::Vector3d::UnitZ());
  look_around_from(Eigen::Vector3d::Zero());
  EXPECT_EQ(map_.apply(change_of({seen_from_behind}, utime_)).unseen, 1);
  EXPECT_EQ(at(map_, wall), Space::kOccupied);
  EXPECT_EQ(at(map_, wall / 2), Space::kUnknown);
  EXPECT_FALSE(map_.coverage().has_value());
  look_around_from({0, 0, 0.06});
  EXPECT_EQ(map_.apply(change_of({seen_from_behind}, utime_)).unseen, 0);
  EXPECT_EQ(at(map_, {0, 0, 0.05}), Space::kFree);
}

TEST_F(OccupancyMapTest, PosesThatAreTooOldSawNothing) {
  constexpr std::int64_t kLater = 3'000'000;  // microseconds, beyond pose_age
  look_around_from(Eigen::Vector3d::Zero());
  // The only pose since looks away.
  map_.add_pose(utime_ + kLater, 0, {Eigen::Quaterniond(0, 0, 1, 0), Eigen::Vector3d(0, 0, -0.01)});
  EXPECT_EQ(map_.apply(change_of({surfel(0, {0, 0, 0.03}, -Eigen::Vector3d::UnitZ())})).unseen, 1);
}

TEST_F(OccupancyMapTest, AResetForgetsTheMapBefore) {
  look_around_from(Eigen::Vector3d::Zero());
  apply(sphere(0.02));
  MapChange change = change_of(plate(0.0305, kBlock), utime_);
  change.reset = true;
  change.map_version = 1;
  look_around_from(Eigen::Vector3d::Zero(), 1);
  map_.apply(change);
  EXPECT_EQ(at(map_, {0, 0, 0.0305}), Space::kOccupied);
  EXPECT_EQ(at(map_, {0, 0, -0.0105}), Space::kUnknown);
  change = change_of({}, utime_);
  change.reset = true;
  map_.apply(change);
  expect_nothing_known();
}

TEST_F(OccupancyMapTest, WallThatMovesOutOfViewIsStillSeenFromWhereItWas) {
  const Eigen::Vector3d normal = -Eigen::Vector3d::UnitZ();
  look_around_from(Eigen::Vector3d::Zero());
  apply({surfel(0, {0, 0, 0.0305}, normal)});
  constexpr std::int64_t kLater = 3'000'000;  // microseconds, beyond pose_age
  map_.add_pose(utime_ + kLater, 0, {Eigen::Quaterniond(0, 0, 1, 0), {0, 0, -0.05}});
  EXPECT_EQ(map_.apply(change_of({surfel(0, {0, 0, 0.0505}, normal)}, utime_ + kLater)).unseen, 0);
  EXPECT_EQ(at(map_, {0, 0, 0.0405}), Space::kFree);
}

// A sphere seen from its centre, then told again in another frame, with other metres.
class OtherFrameTest : public OccupancyMapTest {
 protected:
  static constexpr double kRadius = 0.02;
  static constexpr double kScale = 1.2;

  void tell_again() {
    // In two portions, the second without a reset.
    std::vector<MapSurfel> moved = sphere(kRadius);
    for (MapSurfel& each : moved) {
      each.position = (motion_ * (kScale * each.position.cast<double>())).cast<float>();
      each.normal = (motion_.rotation * each.normal.cast<double>()).cast<float>();
    }
    MapChange change = change_of({}, utime_);
    change.reset = true;
    change.map_version = 1;
    const auto half = moved.begin() + static_cast<std::ptrdiff_t>(moved.size() / 2);
    change.changed.assign(moved.begin(), half);
    EXPECT_EQ(map_.apply(change).unseen, 0);
    change.reset = false;
    change.changed.assign(half, moved.end());
    EXPECT_EQ(map_.apply(change).unseen, 0);
  }

  void expect_the_same_seen() {
    EXPECT_EQ(at(map_, motion_.translation), Space::kFree);
    EXPECT_EQ(at(map_, -motion_.translation), Space::kUnknown);
    EXPECT_NEAR(map_.clearance().value(), kScale * kRadius, kDiagonal);
    EXPECT_EQ(map_.coverage().value(), 1);
  }

  SE3 motion_{Eigen::Quaterniond(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, -1).normalized())),
              {0.05, -0.03, 0.01}};
};

TEST_F(OtherFrameTest, TheSameMapKeepsWhatWasSeen) {
  look_around_from(Eigen::Vector3d::Zero());
  apply(sphere(kRadius));
  constexpr std::int64_t kLater = 3'000'000;  // microseconds: the poses of then are forgotten
  map_.add_pose(utime_ + kLater, 1, motion_);
  tell_again();
  expect_the_same_seen();
}

TEST_F(OtherFrameTest, PosesOfTheFrameBeforeSeeWhatIsNewInTheNextOne) {
  look_around_from(Eigen::Vector3d::Zero());
  // Only a part of the map was told before; no pose is told in the new frame.
  std::vector<MapSurfel> part = sphere(kRadius);
  part.resize(part.size() / 4);
  apply(part);
  tell_again();
  expect_the_same_seen();
}

TEST_F(OccupancyMapTest, AMapThatComesBackWasSeenFromWhereItHadBeen) {
  constexpr std::int64_t kLater = 3'000'000;  // microseconds, beyond pose_age
  constexpr std::int32_t kOtherIds = 100'000;
  std::vector<MapSurfel> wall = sphere(0.02);
  look_around_from(Eigen::Vector3d::Zero());
  apply(wall);
  // Tracking was lost and begins again with another map, in a frame of its own.
  MapChange change = change_of(plate(0.0305, kBlock), utime_ + kLater);
  change.reset = true;
  change.map_version = 1;
  map_.add_pose(change.utime, 1, {});
  EXPECT_EQ(map_.apply(change).unseen, 0);
  EXPECT_EQ(at(map_, {0, 0, -0.0105}), Space::kUnknown);
  // That map is found to belong elsewhere, and the first one comes back.
  for (MapSurfel& each : change.changed) each.position.x() += 0.1F;
  change.map_version = 2;
  map_.apply(change);
  for (MapSurfel& each : wall) each.id += kOtherIds;
  EXPECT_EQ(map_.apply({change.utime, 2, false, {}, wall}).unseen, 0);
  EXPECT_EQ(at(map_, {0, 0, -0.0105}), Space::kFree);
}

TEST_F(OccupancyMapTest, WhatRemainsDoesNotDependOnWhatWasBefore) {
  constexpr std::int32_t kIds = 300;
  constexpr std::uint64_t kSteps = 40;
  constexpr std::uint64_t kPerStep = 100;
  look_around_from(Eigen::Vector3d::Zero());
  const CounterRandom random(4, 0);
  std::map<std::int32_t, MapSurfel> present;
  for (std::uint64_t step = 0; step < kSteps; ++step) {
    MapChange change = change_of({}, utime_);
    for (std::uint64_t i = 0; i < kPerStep; ++i) {
      const std::uint64_t number = step * kPerStep + i;
      const auto id = static_cast<std::int32_t>(random.bits(8 * number) % kIds);
      const Eigen::Vector3d direction = random_direction(random, 4 * number + 1);
      MapSurfel each = surfel(id, 0.03 * direction, -direction);
      each.is_stable = random.uniform(8 * number + 1) < 0.8;
      change.changed.push_back(each);
      present[id] = each;
    }
    if (step + 1 < kSteps) {
      change.removed = {present.begin()->first, present.rbegin()->first, kIds + 5, -3};
      for (const std::int32_t id : change.removed) {
        // Removals come first; what the same message tells anew stays.
        const bool is_told = std::any_of(change.changed.begin(), change.changed.end(),
                                         [id](const MapSurfel& each) { return each.id == id; });
        if (!is_told) present.erase(id);
      }
    }
    map_.apply(change);
    map_.tree();
  }
  OccupancyMap fresh(scene_options());
  std::vector<MapSurfel> last;
  for (const auto& [id, each] : present) last.push_back(each);
  const std::int64_t utime = look_around(fresh, Eigen::Vector3d::Zero(), 0);
  fresh.apply(change_of(last, utime));
  EXPECT_EQ(map_.tree().as_ot({}), fresh.tree().as_ot({}));
  EXPECT_EQ(map_.coverage(), fresh.coverage());
  MapChange nothing = change_of({}, utime_);
  for (std::int32_t id = 0; id < kIds; ++id) nothing.removed.push_back(id);
  map_.apply(nothing);
  expect_nothing_known();
}

TEST_F(OccupancyMapTest, ImpossibleSurfelsAreCountedAndLeftOut) {
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  look_around_from(Eigen::Vector3d::Zero());
  const Eigen::Vector3d place(0, 0, 0.0305);
  const Eigen::Vector3d normal = -Eigen::Vector3d::UnitZ();
  std::vector<MapSurfel> surfels(5, surfel(3, place, normal));
  surfels[0].position.x() = kNaN;
  surfels[1].position.z() = kInfinity;
  surfels[2].position.y() = 1e9F;
  surfels[3].id = -1;
  surfels[4].id = std::numeric_limits<std::int32_t>::max();
  EXPECT_EQ(map_.apply(change_of(surfels, utime_)).unusable, 5);
  expect_nothing_known();
  // A normal that is none leaves the wall without a line of sight.
  MapSurfel odd = surfel(3, place, normal);
  odd.normal.x() = kNaN;
  EXPECT_EQ(map_.apply(change_of({odd}, utime_)).unseen, 1);
  EXPECT_EQ(at(map_, place), Space::kOccupied);
  map_.add_pose(utime_ + 1, 0,
                {Eigen::Quaterniond::Identity(), Eigen::Vector3d(kNaN, kInfinity, 0)});
  EXPECT_TRUE(map_.clearance().has_value());
}

TEST(OccupancyOptionsTest, OptionsThatMakeNoSenseAreRefused) {
  OccupancyOptions options = scene_options();
  options.resolution = 0;
  EXPECT_THROW(OccupancyMap{options}, std::invalid_argument);
  options = scene_options();
  options.camera.width = 0;
  EXPECT_THROW(OccupancyMap{options}, std::invalid_argument);
}

}  // namespace
}  // namespace gastronaut::occupancy

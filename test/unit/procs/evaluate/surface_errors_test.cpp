#include "evaluate/surface_errors.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "evaluate/trajectory_errors.hpp"
#include "random_numbers.hpp"
#include "sphere_mesh.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr double kRounding = 1e-12;  // metres, of doubles at this size
constexpr double kMillimetre = 1e-3;
constexpr double kIcpTolerance = 1e-5;  // metres: where the paper's protocol stops

// 100 x 100 mm of ground with hills of 10 mm, on which nothing can slide.
TriangleMesh hills() {
  constexpr std::uint32_t kSide = 101;
  TriangleMesh mesh;
  for (std::uint32_t i = 0; i < kSide; ++i) {
    for (std::uint32_t k = 0; k < kSide; ++k) {
      const double x = kMillimetre * i;
      const double y = kMillimetre * k;
      mesh.vertices.emplace_back(x, y, 5 * kMillimetre * std::sin(150 * x) * std::cos(110 * y));
    }
  }
  for (std::uint32_t i = 0; i + 1 < kSide; ++i) {
    for (std::uint32_t k = 0; k + 1 < kSide; ++k) {
      const std::uint32_t a = i * kSide + k;
      mesh.triangles.push_back({a, a + kSide, a + 1});
      mesh.triangles.push_back({a + 1, a + kSide, a + kSide + 1});
    }
  }
  return mesh;
}

TriangleMesh square(double side, double z) {
  TriangleMesh mesh;
  const double h = side / 2;
  mesh.vertices = {{-h, -h, z}, {h, -h, z}, {h, h, z}, {-h, h, z}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  return mesh;
}

Points on_surface(const TriangleMesh& mesh, std::size_t count = 5000) {
  return sample_surface(mesh, count);
}

Statistics errors_at(const TrueSurface& surface, const Points& points, const SE3& rig_T_map) {
  return statistics(surface_distances(surface, points, rig_T_map));
}

TEST(SurfaceDistances, OfAPlaneShiftedByAMillimetreAreAMillimetre) {
  const TrueSurface surface(square(0.1, 0));
  const Points points = on_surface(surface.mesh());
  const SE3 shift{Eigen::Quaterniond::Identity(), {0, 0, kMillimetre}};
  const Statistics errors = errors_at(surface, points, shift);
  EXPECT_NEAR(errors.mean, kMillimetre, kRounding);
  EXPECT_NEAR(errors.min, kMillimetre, kRounding);
  EXPECT_NEAR(errors.max, kMillimetre, kRounding);
  EXPECT_NEAR(errors.std, 0, kRounding);
}

TEST(SurfaceDistances, OfALargerSphereAreTheDifferenceOfTheRadii) {
  const TrueSurface surface(sphere_mesh());
  Points points = on_surface(surface.mesh());
  for (Eigen::Vector3d& point : points) point *= 1 + kMillimetre / kSphereRadius;
  const Statistics errors = errors_at(surface, points, SE3{});
  EXPECT_NEAR(errors.mean, kMillimetre, kSphereSagitta);
  EXPECT_NEAR(errors.max, kMillimetre, kSphereSagitta);
}

TEST(Alignment, BothProtocolsUndoARigidMotion) {
  const TrueSurface surface(hills());
  const Points points = on_surface(surface.mesh());
  const SE3 motion{so3_exp({0.01, -0.02, 0.01}), {0.5 * kMillimetre, -kMillimetre, kMillimetre}};
  EXPECT_GT(errors_at(surface, points, motion).mean, 0.5 * kMillimetre);
  const IcpResult paper = align_as_the_paper(surface, points, motion);
  const IcpResult handa = align_as_handa(surface, points, motion);
  EXPECT_LE(handa.iterations, 10);
  // Closest points creep along the slopes, and the protocols stop them early: most is undone.
  constexpr double kLeft = 0.2;
  const double before = errors_at(surface, points, motion).rmse;
  EXPECT_LT(errors_at(surface, points, paper.rig_T_map).rmse, kLeft * before);
  EXPECT_LT(errors_at(surface, points, handa.rig_T_map).rmse, kLeft * before);
  // Left alone for long, they undo all of it.
  const IcpResult patient =
      align_to_surface(surface, points, motion, {.iterations = 300, .tolerance = 1e-9});
  EXPECT_LT(errors_at(surface, points, patient.rig_T_map).rmse, kIcpTolerance);
  EXPECT_NEAR(patient.rig_T_map.translation.norm(), 0, 10 * kIcpTolerance);
}

TEST(Alignment, ThePapersStopsWhereTheErrorNoLongerChanges) {
  const TrueSurface surface(hills());
  const Points points = on_surface(surface.mesh());
  const SE3 motion{so3_exp({0.01, 0, 0}), {0, 0, 2 * kMillimetre}};
  const IcpResult end = align_as_the_paper(surface, points, motion);
  const auto rmse_after = [&](int iterations) {
    const IcpResult result =
        align_to_surface(surface, points, motion, {.iterations = iterations, .tolerance = 0});
    return errors_at(surface, points, result.rig_T_map).rmse;
  };
  ASSERT_GE(end.iterations, 2);
  EXPECT_LT(std::abs(rmse_after(end.iterations) - rmse_after(end.iterations - 1)), kIcpTolerance);
  EXPECT_GE(std::abs(rmse_after(end.iterations - 1) - rmse_after(end.iterations - 2)),
            kIcpTolerance);
}

TEST(Alignment, HandasKeepsThePlacementThatItCannotImprove) {
  // One stray point pulls all the others off the surface: the RMSE falls, the mean rises.
  const TrueSurface surface(square(1, 0));
  Points points = on_surface(square(0.01, 0), 100);
  points.emplace_back(0, 0, 0.1);
  const IcpResult handa = align_as_handa(surface, points, SE3{});
  EXPECT_EQ(handa.iterations, 0);
  EXPECT_EQ(handa.rig_T_map.translation, Eigen::Vector3d::Zero().eval());
}

TEST(Alignment, DoesNotChangeTheSizeOfTheMap) {
  const TrueSurface surface(sphere_mesh());
  Points points = on_surface(surface.mesh());
  for (Eigen::Vector3d& point : points) point *= 1.1;
  const IcpResult aligned = align_as_the_paper(surface, points, SE3{});
  EXPECT_NEAR(errors_at(surface, points, aligned.rig_T_map).mean, 0.1 * kSphereRadius,
              kSphereSagitta);
}

PoseChannel visual_poses(const SE3& map_T_rig, const TruthTrack& truth) {
  PoseChannel channel{
      "VISUAL_POSE", PoseKind::kCameraInMap, 6, {{"OK", true}, {"LOST", false}}, {}, {}};
  for (std::size_t i = 0; i < truth.size(); ++i) {
    channel.fixes.push_back({truth.utimes()[i], 0, map_T_rig * truth.poses()[i], {}});
  }
  return channel;
}

TruthTrack straight_path() {
  TruthTrack truth;
  for (int i = 0; i < 20; ++i) truth.add(50000 * i, {so3_exp({0.3, 0, 0}), {0.001 * i, 0.01, 0}});
  return truth;
}

constexpr double kDistance = 0.04;  // metres, of what is seen

TEST(PlaceByTrajectory, FindsTheMapOfAStraightPathToo) {
  const SE3 rig_T_map{so3_exp({0.4, -1, 2}), {0.1, 0.2, -0.3}};
  const TruthTrack truth = straight_path();
  PoseChannel poses = visual_poses(rig_T_map.inverse(), truth);
  // What is lost has no say.
  poses.fixes[5].status = 1;
  poses.fixes[5].pose.translation += Eigen::Vector3d(1, 1, 1);
  const auto placed = place_by_trajectory(poses, truth, kDistance);
  ASSERT_TRUE(placed);
  EXPECT_NEAR((*placed * rig_T_map.inverse()).log().norm(), 0, kRounding);
}

TEST(PlaceByTrajectory, NothingWithoutPosesThatHaveTruth) {
  const TruthTrack truth = straight_path();
  EXPECT_FALSE(place_by_trajectory(visual_poses(SE3{}, TruthTrack()), truth, kDistance));
  EXPECT_FALSE(place_by_trajectory(visual_poses(SE3{}, truth), TruthTrack(), kDistance));
}

TEST(PointsInView, AreInThePictureAndNotHidden) {
  TriangleMesh mesh = square(0.4, 0.05);
  const TriangleMesh screen = square(0.01, 0.025);  // hides 20 x 20 mm of what is behind
  for (const auto& vertex : screen.vertices) mesh.vertices.push_back(vertex);
  for (const auto& [a, b, c] : screen.triangles) mesh.triangles.push_back({a + 4, b + 4, c + 4});
  const TrueSurface surface(mesh);
  const CameraIntrinsics picture{100, 100, 50, 50, 49.5, 49.5, LensModel::kRadialTangential, {}};
  const CameraModel camera(picture);  // sees 100 x 100 mm at 50 mm
  constexpr std::size_t kSamples = 160000;
  const Points behind = points_in_view(surface, sample_surface(square(0.4, 0.05), kSamples), camera,
                                       std::vector<SE3>(1));
  const double share = static_cast<double>(behind.size()) / kSamples;
  constexpr double kExpected = (0.1 * 0.1 - 0.02 * 0.02) / (0.4 * 0.4);
  EXPECT_NEAR(share, kExpected, 0.02 * kExpected);  // 9600 of the random points
  const SE3 turned_away{so3_exp({0, M_PI, 0}), {0, 0, 0}};
  EXPECT_TRUE(points_in_view(surface, behind, camera, std::vector<SE3>{turned_away}).empty());
  EXPECT_EQ(points_in_view(surface, behind, camera, std::vector<SE3>{turned_away, SE3{}}).size(),
            behind.size());
}

TEST(CloudDistances, AreThoseOfAllPairsWithinReach) {
  constexpr double kReach = 0.3;
  Draws draws(3);
  Points cloud;
  Points points;
  for (int i = 0; i < 500; ++i) cloud.push_back(draws.vector(1));
  for (int i = 0; i < 200; ++i) points.push_back(draws.vector(1));
  const std::vector<double> distances = cloud_distances(points, cloud, kReach);
  int beyond = 0;
  for (std::size_t i = 0; i < points.size(); ++i) {
    double least = std::numeric_limits<double>::infinity();
    for (const Eigen::Vector3d& other : cloud) least = std::min(least, (other - points[i]).norm());
    if (least <= kReach) {
      EXPECT_DOUBLE_EQ(distances[i], least);
    } else {
      EXPECT_EQ(distances[i], std::numeric_limits<double>::infinity());
      ++beyond;
    }
  }
  EXPECT_GT(beyond, 0);
  EXPECT_LT(beyond, 200);
  EXPECT_DOUBLE_EQ(share_within(distances, kReach), 1 - beyond / 200.0);
  EXPECT_TRUE(std::isnan(share_within({}, kReach)));
}

}  // namespace
}  // namespace gastronaut::evaluation

#include "evaluate/surface_placement.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <string>

#include "evaluate/trajectory_errors.hpp"
#include "numerics/parallel.hpp"
#include "random_numbers.hpp"
#include "sphere_mesh.hpp"

namespace gastronaut::evaluation {
namespace {

using testing::HasSubstr;

constexpr double kRounding = 1e-12;  // metres, of doubles at this size
constexpr double kMillimetre = 1e-3;
// What closest points leave when they stop: far less than any error that one would measure.
constexpr double kLeft = 0.02 * kMillimetre;

std::string written(const std::string& text) {
  const std::string path = testing::TempDir() + "/pairs_" +
                           testing::UnitTest::GetInstance()->current_test_info()->name() + ".csv";
  std::ofstream(path) << text;
  return path;
}

std::string problem_with(const std::string& text) {
  try {
    place_by_pairs(read_pairs(written(text)));
  } catch (const std::exception& error) {
    return error.what();
  }
  return "";
}

// A closed bag that is like itself from no other side: an ellipsoid, bent, with a bulge.
TriangleMesh bag() {
  TriangleMesh mesh = sphere_mesh();
  for (Eigen::Vector3d& vertex : mesh.vertices) {
    const Eigen::Vector3d unit = vertex / kSphereRadius;
    const double bulge = 0.35 * std::exp(-6 * (unit - Eigen::Vector3d(0.6, 0.8, 0)).squaredNorm());
    vertex = (1 + bulge) * vertex.cwiseProduct(Eigen::Vector3d(1.6, 1.1, 0.8));
    vertex.z() += 6 * vertex.x() * vertex.x() + 4 * vertex.x() * vertex.y();
  }
  return mesh;
}

const SE3 kRigTMap{so3_exp({1.9, -1.2, 0.7}), {0.3, -0.2, 0.1}};

Points in_map_frame(Points points) {
  for (Eigen::Vector3d& point : points) point = kRigTMap.inverse() * point;
  return points;
}

double largest_difference(const Points& points, const SE3& a, const SE3& b) {
  double largest = 0;
  for (const Eigen::Vector3d& point : points) {
    largest = std::max(largest, (a * point - b * point).norm());
  }
  return largest;
}

TEST(PickedPairs, GiveTheMotionBetweenThem) {
  Draws draws(5);
  std::ostringstream text;
  text.precision(17);
  text << "map_x,map_y,map_z,surface_x,surface_y,surface_z\n# six, as in the paper\n\n";
  Points points;
  for (int i = 0; i < 6; ++i) {
    points.push_back(draws.vector(0.05));
    const Eigen::Vector3d there = kRigTMap * points.back();
    text << points.back().x() << ", " << points.back().y() << "," << points.back().z() << ","
         << there.x() << "," << there.y() << "," << there.z() << "\r\n";
  }
  const std::vector<PointPair> pairs = read_pairs(written(text.str()));
  ASSERT_EQ(pairs.size(), 6U);
  EXPECT_LT(largest_difference(points, place_by_pairs(pairs), kRigTMap), kRounding);
}

TEST(PickedPairs, ThatDoNotDetermineAPlaceAreRefused) {
  EXPECT_THAT(problem_with("0,0,0,0,0,0\n1,0,0,1,0,0\n"), HasSubstr("three or more"));
  EXPECT_THAT(problem_with("0,0,0,0,0,0\n1,0,0,1,0,0\n2,0,0,0,3,0\n"), HasSubstr("on the map lie"));
  EXPECT_THAT(problem_with("0,0,0,0,0,0\n1,0,0,1,1,1\n0,2,0,3,3,3\n"),
              HasSubstr("on the surface lie"));
  EXPECT_THAT(problem_with("0,0,0,0,0,0\n0,0,0,0,0,0\n0,0,0,0,0,0\n"), HasSubstr("on a line"));
  EXPECT_EQ(problem_with("0,0,0,0,0,0\n1,0,0,1,0,0\n0,1,0,0,1,0\n"), "");
}

TEST(PickedPairs, WhatIsNoPairIsNamedByItsLine) {
  for (const char* row : {"1,2,3,4,5", "1,2,3,4,5,6,7", "1,2,three,4,5,6", "1,2,3,4,5,nan"}) {
    EXPECT_THAT(problem_with(std::string("0,0,0,0,0,0\n") + row + "\n"), HasSubstr(".csv:2: "))
        << row;
  }
  EXPECT_THROW(read_pairs(testing::TempDir() + "/absent.csv"), std::runtime_error);
}

TEST(PlaceByShape, FindsAWholeMapInAFrameOfItsOwn) {
  const TrueSurface surface(bag());
  const Points points = in_map_frame(sample_surface(surface.mesh(), 3000));
  const ShapePlacement placement = place_by_shape(surface, points);
  EXPECT_LT(largest_difference(points, placement.rig_T_map, kRigTMap), 10 * kLeft);
  EXPECT_LT(placement.rmse, kLeft);
  EXPECT_GT(placement.next_rmse, kMillimetre);  // and no other place comes near
}

TEST(PlaceByShape, FindsTheHalfThatACapsuleHasSeen) {
  const TrueSurface surface(bag());
  Points points = sample_surface(surface.mesh(), 4000);
  std::erase_if(points, [](const Eigen::Vector3d& p) { return p.x() + 0.3 * p.y() < 0; });
  points = in_map_frame(points);
  const ShapePlacement placement = place_by_shape(surface, points);
  EXPECT_LT(largest_difference(points, placement.rig_T_map, kRigTMap), 10 * kLeft);
  EXPECT_LT(placement.rmse, kLeft);
}

TEST(PlaceByShape, IsTheSameWhateverTheNumberOfThreads) {
  const TrueSurface surface(bag());
  const Points points = in_map_frame(sample_surface(surface.mesh(), 300));
  set_thread_count(1);
  const SE3 one = place_by_shape(surface, points).rig_T_map;
  set_thread_count(3);
  const SE3 three = place_by_shape(surface, points).rig_T_map;
  set_thread_count(0);
  EXPECT_EQ(one.matrix(), three.matrix());
}

}  // namespace
}  // namespace gastronaut::evaluation

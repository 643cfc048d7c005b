#include "evaluate/true_surface.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <filesystem>
#include <limits>
#include <stdexcept>

#include "random_numbers.hpp"
#include "sphere_mesh.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr double kRounding = 1e-12;  // metres, of doubles at this size

TEST(NearestOnTriangle, NoPointOfTheTriangleIsNearer) {
  Draws draws(1);
  constexpr int kSteps = 100;
  for (int trial = 0; trial < 50; ++trial) {
    const Eigen::Vector3d a = draws.vector(1);
    const Eigen::Vector3d b = draws.vector(1);
    const Eigen::Vector3d c = draws.vector(1);
    const Eigen::Vector3d point = draws.vector(2);
    const double found = (nearest_on_triangle(point, a, b, c) - point).norm();
    double least = std::numeric_limits<double>::infinity();
    for (int i = 0; i <= kSteps; ++i) {
      for (int k = 0; k <= kSteps - i; ++k) {
        const Eigen::Vector3d on = a + (b - a) * i / kSteps + (c - a) * k / kSteps;
        least = std::min(least, (on - point).norm());
      }
    }
    // The points tried are no further than this from any other.
    const double spacing = ((b - a).norm() + (c - a).norm()) / kSteps;
    EXPECT_LE(found, least + kRounding);
    EXPECT_GE(found, least - spacing);
  }
}

TEST(TrueSurface, NearestIsThatOfAllTriangles) {
  const TriangleMesh mesh = sphere_mesh();
  const TrueSurface surface(mesh);
  Draws draws(2);
  for (int trial = 0; trial < 30; ++trial) {
    const Eigen::Vector3d point = draws.vector(kSphereRadius);
    double least = std::numeric_limits<double>::infinity();
    for (const auto& [a, b, c] : mesh.triangles) {
      const Eigen::Vector3d nearest =
          nearest_on_triangle(point, mesh.vertices[a], mesh.vertices[b], mesh.vertices[c]);
      least = std::min(least, (nearest - point).norm());
    }
    EXPECT_NEAR((surface.nearest(point) - point).norm(), least, kRounding);
    EXPECT_NEAR(least, std::abs(point.norm() - kSphereRadius), kSphereSagitta);
  }
}

TEST(TrueSurface, FindsTheNearestFromVeryFarToo) {
  const TrueSurface surface(sphere_mesh());
  EXPECT_NEAR((surface.nearest({0, 0, 50}) - Eigen::Vector3d(0, 0, kSphereRadius)).norm(), 0,
              kSphereSagitta);
}

TEST(TrueSurface, SeesAPointUnlessSomethingIsBetween) {
  const TrueSurface surface(sphere_mesh());
  const Eigen::Vector3d near(kSphereRadius, 0, 0);
  EXPECT_TRUE(surface.sees({0, 0, 0}, near));
  EXPECT_TRUE(surface.sees({2 * kSphereRadius, 0, 0}, near));
  EXPECT_FALSE(surface.sees({2 * kSphereRadius, 0, 0}, -near));
}

TEST(TrueSurface, RefusesToBeEmpty) { EXPECT_THROW(TrueSurface({}), std::invalid_argument); }

TEST(SampleSurface, LargeTrianglesGetMorePoints) {
  TriangleMesh mesh;
  mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {5, 0, 0}, {8, 0, 0}, {5, 1, 0}};
  mesh.triangles = {{0, 1, 2}, {3, 4, 5}};  // areas as 1 to 3
  constexpr std::size_t kCount = 4000;
  const std::vector<Eigen::Vector3d> points = sample_surface(mesh, kCount);
  ASSERT_EQ(points.size(), kCount);
  const auto in_first = std::count_if(points.begin(), points.end(),
                                      [](const Eigen::Vector3d& p) { return p.x() < 2; });
  EXPECT_NEAR(static_cast<double>(in_first), kCount / 4.0, 1);  // evenly, not by chance
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& point : points) {
    EXPECT_LE(
        (nearest_on_triangle(point, mesh.vertices[0], mesh.vertices[1], mesh.vertices[2]) - point)
                .norm() *
            (nearest_on_triangle(point, mesh.vertices[3], mesh.vertices[4], mesh.vertices[5]) -
             point)
                .norm(),
        kRounding);
    if (point.x() > 2) mean += point / static_cast<double>(kCount - kCount / 4);
  }
  // The centroid, within four standard errors of uniform points.
  EXPECT_NEAR(mean.x(), 6, 4 * (3 / std::sqrt(18.0)) / std::sqrt(3000.0));
  EXPECT_NEAR(mean.y(), 1 / 3.0, 4 * (1 / std::sqrt(18.0)) / std::sqrt(3000.0));
}

class ReadSurfaceTest : public testing::Test {
 protected:
  void write(const std::string& contents) const {
    std::ofstream(path_, std::ios::binary) << contents;
  }
  template <class... Values>
  static std::string bytes(Values... values) {
    std::string text;
    const auto append = [&text](auto value) {
      char raw[sizeof value];
      std::memcpy(raw, &value, sizeof value);
      text.append(raw, sizeof value);
    };
    (append(values), ...);
    return text;
  }

  std::string path_ = testing::TempDir() + "/surface_" +
                      testing::UnitTest::GetInstance()->current_test_info()->name() + ".ply";
};

constexpr const char* kFaces = "property list uchar int vertex_indices\nend_header\n";
constexpr const char* kVertices =
    "property float x\nproperty float y\nproperty float z\nelement face 1\n";

TEST_F(ReadSurfaceTest, ReadsAsciiAndCutsPolygons) {
  write(std::string("ply\r\nformat ascii 1.0\r\ncomment of a square\nelement vertex 4\n") +
        kVertices + kFaces + "0 0 0\n1 0 0\n1 1 0\n0 1e0 0\n4 0 1 2 3\n");
  const TriangleMesh mesh = read_surface(path_);
  ASSERT_EQ(mesh.vertices.size(), 4U);
  EXPECT_EQ(mesh.vertices[3], Eigen::Vector3d(0, 1, 0));
  using Triangle = std::array<std::uint32_t, 3>;
  EXPECT_EQ(mesh.triangles, (std::vector<Triangle>{{0, 1, 2}, {0, 2, 3}}));
}

TEST_F(ReadSurfaceTest, ReadsBinaryWithOtherPropertiesInBetween) {
  write(
      "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty uchar red\n"
      "property double z\nproperty double y\nproperty double x\nelement edge 1\n"
      "property int vertex1\nelement face 1\nproperty list uint8 int16 colours\n"
      "property list uint8 uint32 vertex_index\nend_header\n" +
      bytes(std::uint8_t{9}, 3.0, 2.0, 1.0, std::uint8_t{9}, 0.0, 0.0, 0.0, std::uint8_t{9}, 0.0,
            1.0, 0.0) +
      bytes(std::int32_t{77}) +
      bytes(std::uint8_t{2}, std::int16_t{5}, std::int16_t{6}, std::uint8_t{3}, 2U, 1U, 0U));
  const TriangleMesh mesh = read_surface(path_);
  ASSERT_EQ(mesh.vertices.size(), 3U);
  EXPECT_EQ(mesh.vertices[0], Eigen::Vector3d(1, 2, 3));
  ASSERT_EQ(mesh.triangles.size(), 1U);
  EXPECT_EQ(mesh.triangles[0], (std::array<std::uint32_t, 3>{2, 1, 0}));
}

TEST_F(ReadSurfaceTest, RefusesWhatIsNoSurface) {
  EXPECT_THROW(read_surface(path_ + ".absent"), std::runtime_error);
  const std::string head = "ply\nformat ascii 1.0\nelement vertex 3\n";
  const std::string points = "0 0 0\n1 0 0\n0 1 0\n";
  for (const std::string& contents :
       {std::string(), std::string("solid cube\n"), head,
        head + kVertices + kFaces + points,                 // the face is missing
        head + kVertices + kFaces + points + "3 0 1 3\n",   // there is no vertex 3
        head + kVertices + kFaces + points + "3 0 1 -2\n",  //
        head + kVertices + kFaces + points + "2 0 1\n",     // no triangle
        head + kVertices + kFaces + "0 0 nan\n1 0 0\n0 1 0\n3 0 1 2\n",
        head + kVertices + kFaces + "0 0 here\n1 0 0\n0 1 0\n3 0 1 2\n",
        "ply\nformat binary_big_endian 1.0\nelement vertex 3\n" + std::string(kVertices) + kFaces,
        "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999999\n" +
            std::string(kVertices) + kFaces,
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty quaternion x\n" + std::string(kFaces)}) {
    write(contents);
    EXPECT_THROW(read_surface(path_), std::runtime_error) << contents;
  }
}

}  // namespace
}  // namespace gastronaut::evaluation

#include "surfels/surfel_mesh.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iterator>
#include <limits>
#include <map>
#include <numbers>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace gastronaut {
namespace {

// A camera makes a surfel a pixel, with a radius of sqrt(2) pixels.
constexpr double kRadius = 0.0005;  // metres
constexpr double kSpacing = kRadius / std::numbers::sqrt2;
// What the header promises.
constexpr double kVoxel = 1.25 * kRadius;
constexpr double kSupport = 2 * kRadius;
// Vertices move by up to this, so that none coincide.
constexpr double kNudge = 0.01 * kVoxel;
// Any point of the mesh is on a tetrahedron with the border of the support in it.
const double kLongestEdge = std::sqrt(3.0) * kVoxel;

using Surfels = std::vector<Surfel>;
using Colour = std::array<std::uint8_t, 3>;

void add(Surfels& surfels, const Eigen::Vector3d& position, const Eigen::Vector3d& normal,
         const Colour& colour = {}) {
  surfels.push_back({position.cast<float>(), normal.normalized().cast<float>(), colour,
                     static_cast<float>(kRadius), 1, 0});
}

constexpr Colour kLeft = {200, 50, 100};
constexpr Colour kRight = {100, 50, 200};
constexpr double kSide = 0.02;  // metres, of the sheets below

// A square at `place`, facing `normal`, without the surfels that keep(x, y in the square) refuses.
void add_sheet(
    Surfels& s, const Eigen::Vector3d& place, const Eigen::Vector3d& normal,
    const std::function<bool(double, double)>& keep = [](double, double) { return true; }) {
  const Eigen::Vector3d x = normal.unitOrthogonal();
  const Eigen::Vector3d y = normal.normalized().cross(x);
  const int count = static_cast<int>(kSide / kSpacing);
  for (int i = 0; i <= count; ++i) {
    for (int j = 0; j <= count; ++j) {
      const double u = i * kSpacing - kSide / 2;
      const double v = j * kSpacing - kSide / 2;
      if (keep(u, v)) add(s, place + u * x + v * y, normal, u < 0 ? kLeft : kRight);
    }
  }
}

// Along no axis and no diagonal of the grid.
const Eigen::Vector3d kNormal = Eigen::Vector3d(0.3, -0.5, 0.9).normalized();
const Eigen::Vector3d kPlace(0.0123, -0.0321, 0.0456);

double height(const Eigen::Vector3f& vertex) { return kNormal.dot(vertex.cast<double>() - kPlace); }
double from_middle(const Eigen::Vector3f& vertex) {
  return (vertex.cast<double>() - kPlace - height(vertex) * kNormal).norm();
}

Eigen::Vector3d face(const TriangleMesh& mesh, const std::array<std::int32_t, 3>& triangle) {
  const auto at = [&](std::size_t k) -> Eigen::Vector3d {
    return mesh.vertices[static_cast<std::size_t>(triangle[k])].cast<double>();
  };
  return (at(1) - at(0)).cross(at(2) - at(0)) / 2;
}

double area(const TriangleMesh& mesh) {
  double sum = 0;
  for (const auto& triangle : mesh.triangles) sum += face(mesh, triangle).norm();
  return sum;
}

// How many triangles go along each edge, by direction.
std::map<std::pair<std::int32_t, std::int32_t>, int> edges(const TriangleMesh& mesh) {
  std::map<std::pair<std::int32_t, std::int32_t>, int> count;
  for (const auto& t : mesh.triangles) {
    for (std::size_t k = 0; k < 3; ++k) ++count[{t[k], t[(k + 1) % 3]}];
  }
  return count;
}

// Edges with a triangle on one side alone.
std::vector<std::pair<std::int32_t, std::int32_t>> border(const TriangleMesh& mesh) {
  std::vector<std::pair<std::int32_t, std::int32_t>> border;
  const auto count = edges(mesh);
  for (const auto& [edge, times] : count) {
    if (!count.contains({edge.second, edge.first})) border.push_back(edge);
  }
  return border;
}

// What any mesh keeps to.
void expect_sound(const TriangleMesh& mesh) {
  ASSERT_EQ(mesh.normals.size(), mesh.vertices.size());
  ASSERT_EQ(mesh.colours.size(), mesh.vertices.size());
  constexpr float kUnit = 1e-5F;  // some roundings of float
  for (const auto& normal : mesh.normals) ASSERT_NEAR(normal.norm(), 1, kUnit);
  std::vector<bool> used(mesh.vertices.size());
  for (const auto& t : mesh.triangles) {
    Eigen::Vector3f normal = Eigen::Vector3f::Zero();
    for (const std::int32_t k : t) {
      ASSERT_GE(k, 0);
      ASSERT_LT(static_cast<std::size_t>(k), mesh.vertices.size());
      used[static_cast<std::size_t>(k)] = true;
      normal += mesh.normals[static_cast<std::size_t>(k)];
    }
    ASSERT_GT(face(mesh, t).dot(normal.cast<double>()), 0);
  }
  EXPECT_EQ(std::count(used.begin(), used.end(), false), 0);
  for (const auto& [edge, times] : edges(mesh)) ASSERT_EQ(times, 1);  // else they lie on each other
}

TEST(SurfelMesh, PlaneBecomesThePlaneAndEndsWhereTheSurfelsEnd) {
  Surfels surfels;
  add_sheet(surfels, kPlace, kNormal);
  const TriangleMesh mesh = triangulate(surfels);
  expect_sound(mesh);
  for (std::size_t k = 0; k < mesh.vertices.size(); ++k) {
    ASSERT_LE(std::abs(height(mesh.vertices[k])), kNudge);
    constexpr double kSameDirection = 1e-5;  // some roundings of float
    ASSERT_LE((mesh.normals[k].cast<double>() - kNormal).norm(), kSameDirection);
    ASSERT_LE(from_middle(mesh.vertices[k]), kSide / std::numbers::sqrt2 + kSupport);
  }
  // The mesh goes as far as all corners of its tetrahedra are supported.
  EXPECT_LE(std::sqrt(area(mesh)), kSide + 2 * kSupport);
  EXPECT_GE(std::sqrt(area(mesh)), kSide - 2 * (kLongestEdge - kSupport));
}

TEST(SurfelMesh, ColourIsThatOfTheSurfelsNearby) {
  Surfels surfels;
  add_sheet(surfels, kPlace, kNormal);
  const TriangleMesh mesh = triangulate(surfels);
  const Eigen::Vector3d x = kNormal.unitOrthogonal();
  constexpr float kRounding = 255 * 1e-5F;  // of a mean of some floats
  int near_edge = 0;
  for (std::size_t k = 0; k < mesh.vertices.size(); ++k) {
    const double u = x.dot(mesh.vertices[k].cast<double>() - kPlace);
    for (std::size_t c = 0; c < 3; ++c) {
      const float colour = mesh.colours[k][static_cast<Eigen::Index>(c)];
      const auto [least, most] = std::minmax(kLeft[c], kRight[c]);
      ASSERT_GE(colour, static_cast<float>(least) - kRounding);
      ASSERT_LE(colour, static_cast<float>(most) + kRounding);
      if (std::abs(u) > kSupport + kLongestEdge) {
        ASSERT_NEAR(colour, static_cast<float>(u < 0 ? kLeft[c] : kRight[c]), kRounding);
      } else {
        ++near_edge;
      }
    }
  }
  EXPECT_GT(near_edge, 0);
}

TEST(SurfelMesh, SphereSeenFromInsideIsClosedAndOfTheRightSize) {
  constexpr double kSphere = 0.01;  // metres, radius
  // Fibonacci's sphere, as dense as a camera's surfels.
  const int count =
      static_cast<int>(4 * std::numbers::pi * kSphere * kSphere / kSpacing / kSpacing);
  Surfels surfels;
  for (int k = 0; k < count; ++k) {
    const double z = 1 - (2 * k + 1.0) / count;
    const double turn = 2 * std::numbers::pi * k / std::numbers::phi;
    const double r = std::sqrt(1 - z * z);
    const Eigen::Vector3d out(r * std::cos(turn), r * std::sin(turn), z);
    add(surfels, kPlace + kSphere * out, -out);
  }
  const TriangleMesh mesh = triangulate(surfels);
  expect_sound(mesh);
  EXPECT_TRUE(border(mesh).empty());
  // Euler's characteristic of one sphere. Each edge was counted once each way.
  EXPECT_EQ(mesh.vertices.size() + mesh.triangles.size() - edges(mesh).size() / 2, 2U);

  // Planes of the surfels within reach touch the sphere and lie outside of it elsewhere, by less
  // than reach^2 / 2 radii; between the ends of an edge the sphere bends by edge^2 / 8 radii.
  const double bend = (kSupport * kSupport / 2 + kLongestEdge * kLongestEdge / 8) / kSphere;
  const double tolerance = bend + kNudge;
  // What the normals at both ends of an edge differ by, and what of it interpolating may leave.
  const double turn = (kSupport + kLongestEdge) / kSphere;
  for (std::size_t k = 0; k < mesh.vertices.size(); ++k) {
    const Eigen::Vector3d out = mesh.vertices[k].cast<double>() - kPlace;
    ASSERT_NEAR(out.norm(), kSphere, tolerance);
    ASSERT_GE(-out.normalized().dot(mesh.normals[k].cast<double>()), std::cos(turn));
  }
  EXPECT_NEAR(std::sqrt(area(mesh) / (4 * std::numbers::pi)), kSphere, tolerance);
}

TEST(SurfelMesh, HoleStaysAHole) {
  constexpr double kHole = 10 * kRadius;
  Surfels surfels;
  add_sheet(surfels, kPlace, kNormal, [](double u, double v) { return std::hypot(u, v) > kHole; });
  const TriangleMesh mesh = triangulate(surfels);
  expect_sound(mesh);
  double nearest = kSide;
  for (const auto& vertex : mesh.vertices) nearest = std::min(nearest, from_middle(vertex));
  EXPECT_GE(nearest, kHole - kSupport);
  EXPECT_LE(nearest, kHole + kLongestEdge);
}

TEST(SurfelMesh, MissingSurfelIsNoHole) {
  Surfels surfels;
  add_sheet(surfels, kPlace, kNormal,
            [](double u, double v) { return std::hypot(u, v) > kSpacing / 2; });
  const TriangleMesh mesh = triangulate(surfels);
  for (const auto& [from, to] : border(mesh)) {
    ASSERT_GE(from_middle(mesh.vertices[static_cast<std::size_t>(from)]),
              kSide / 2 - (kLongestEdge - kSupport));
  }
}

TEST(SurfelMesh, SheetsFiveRadiiApartStayTwo) {
  constexpr double kGap = 5 * kRadius;
  constexpr int kToEachOther = 0, kAway = 1, kBothUp = 2;
  for (const int facing : {kToEachOther, kAway, kBothUp}) {
    SCOPED_TRACE(facing);
    const double lower = facing == kAway ? -1 : 1;
    const double upper = facing == kToEachOther ? -1 : 1;
    Surfels surfels;
    add_sheet(surfels, kPlace, lower * kNormal);
    const double one = area(triangulate(surfels));
    add_sheet(surfels, kPlace + kGap * kNormal, upper * kNormal);
    const TriangleMesh mesh = triangulate(surfels);
    expect_sound(mesh);
    for (std::size_t k = 0; k < mesh.vertices.size(); ++k) {
      const double h = height(mesh.vertices[k]);
      const bool is_upper = h > kGap / 2;
      ASSERT_LE(std::abs(is_upper ? h - kGap : h), kNudge);
      ASSERT_GT(mesh.normals[k].cast<double>().dot((is_upper ? upper : lower) * kNormal), 0);
    }
    // The two borders lie on the grid differently: a voxel along four sides.
    EXPECT_NEAR(area(mesh), 2 * one, 4 * kSide * kVoxel);
  }
}

TEST(SurfelMesh, LonelySurfelMakesNoMoreThanItsSupport) {
  Surfels surfels;
  add(surfels, kPlace, kNormal);
  const TriangleMesh mesh = triangulate(surfels);
  expect_sound(mesh);
  EXPECT_LE(area(mesh), std::numbers::pi * kSupport * kSupport);
}

TEST(SurfelMesh, VoxelsThatMakeNoSenseAreRefused) {
  Surfels surfels;
  add_sheet(surfels, kPlace, kNormal);
  for (const double voxel : {-kVoxel, 0.4 * kRadius, std::numeric_limits<double>::quiet_NaN(),
                             std::numeric_limits<double>::infinity()}) {
    EXPECT_THROW(triangulate(surfels, voxel), std::invalid_argument) << voxel;
  }
  constexpr double kFar = 1e7 * kVoxel;
  add(surfels, {0, kFar, 0}, kNormal);
  EXPECT_THROW(triangulate(surfels), std::invalid_argument);
}

class MeshFile : public testing::Test {
 protected:
  MeshFile() {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    folder_ = std::filesystem::temp_directory_path() / (std::string("mesh_file_") + test->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~MeshFile() override { std::filesystem::remove_all(folder_); }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }
  std::string read(const std::string& name) const {
    std::ifstream file(path(name), std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }

 private:
  std::filesystem::path folder_;
};

std::string header(std::size_t vertices, std::size_t faces) {
  std::string text = "ply\nformat binary_little_endian 1.0\ncomment mesh of surfels, in metres\n";
  text += "element vertex " + std::to_string(vertices) + '\n';
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) {
    text += std::string("property float ") + name + '\n';
  }
  for (const char* name : {"red", "green", "blue"}) {
    text += std::string("property uchar ") + name + '\n';
  }
  text += "element face " + std::to_string(faces) + '\n';
  return text + "property list uchar int vertex_indices\nend_header\n";
}

TEST_F(MeshFile, IsPlyOfVerticesAndTriangles) {
  const TriangleMesh mesh = {{{1, 2, 3}, {4, 5, 6}, {7, 8, -9}},
                             {{1, 0, 0}, {0, 1, 0}, {0, 0, -1}},
                             {{0, 10, 255}, {1, 2, 3}, {51.4F, 51.5F, 0}},
                             {{0, 1, 2}}};
  export_mesh(path("mesh.ply"), mesh);
  EXPECT_FALSE(std::filesystem::exists(path("mesh.ply.partial")));
  std::string expected = header(3, 1);
  const auto append = [&](const auto& value) {
    expected.append(reinterpret_cast<const char*>(&value), sizeof value);
  };
  const std::array<Colour, 3> colours = {{{0, 10, 255}, {1, 2, 3}, {51, 52, 0}}};
  for (std::size_t k = 0; k < 3; ++k) {
    for (const float number : mesh.vertices[k]) append(number);
    for (const float number : mesh.normals[k]) append(number);
    append(colours[k]);
  }
  append(static_cast<unsigned char>(3));
  for (const std::int32_t index : {0, 1, 2}) append(index);
  EXPECT_EQ(read("mesh.ply"), expected);
}

TEST_F(MeshFile, OfAnEmptyMapIsEmptyAndWhole) {
  export_mesh(path("mesh.ply"), triangulate({}));
  EXPECT_EQ(read("mesh.ply"), header(0, 0));
}

TEST_F(MeshFile, SameSurfelsGiveTheSameBytes) {
  Surfels surfels;
  add_sheet(surfels, kPlace, kNormal);
  export_mesh(path("one.ply"), triangulate(surfels));
  export_mesh(path("two.ply"), triangulate(surfels));
  EXPECT_EQ(read("one.ply"), read("two.ply"));
}

TEST_F(MeshFile, UnwritablePathSaysWhy) {
  const auto message = [&](const std::string& name) {
    try {
      export_mesh(path(name), {});
    } catch (const std::runtime_error& error) {
      return std::string(error.what());
    }
    return std::string("no error");
  };
  EXPECT_THAT(message("no/such/mesh.ply"),
              testing::AllOf(testing::HasSubstr("no/such/mesh.ply"),
                             testing::HasSubstr(std::strerror(ENOENT))));
  std::filesystem::create_symlink("/dev/full", path("full.ply.partial"));
  TriangleMesh large;  // than what a stream keeps to itself
  constexpr std::size_t kLarge = 100'000;
  large.vertices.resize(kLarge, Eigen::Vector3f::Zero());
  large.normals.resize(kLarge, Eigen::Vector3f::UnitZ());
  large.colours.resize(kLarge, Eigen::Vector3f::Zero());
  try {
    export_mesh(path("full.ply"), large);
    ADD_FAILURE() << "no error";
  } catch (const std::runtime_error& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr(std::strerror(ENOSPC)));
  }
  EXPECT_FALSE(std::filesystem::exists(path("full.ply")));
}

}  // namespace
}  // namespace gastronaut

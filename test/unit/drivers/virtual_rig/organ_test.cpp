#include "virtual_rig/organ.hpp"

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>

namespace gastronaut {
namespace {

OrganConfiguration coarse() {
  OrganConfiguration organ;
  organ.edge = 0.002;
  return organ;
}

// How many edges belong to one triangle only.
std::size_t open_edges(const TriangleMesh& mesh) {
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  for (const Triangle& t : mesh.triangles) {
    for (std::size_t i = 0; i < 3; ++i) ++edges[std::minmax(t[i], t[(i + 1) % 3])];
  }
  std::size_t open = 0;
  for (const auto& [edge, triangles] : edges) open += triangles == 1;
  return open;
}

Eigen::Vector3d extent(const TriangleMesh& mesh) {
  Eigen::Vector3f low = mesh.vertices.front();
  Eigen::Vector3f high = low;
  for (const auto& vertex : mesh.vertices) {
    low = low.cwiseMin(vertex);
    high = high.cwiseMax(vertex);
  }
  return (high - low).cast<double>();
}

TEST(Organ, ClosedStomachIsClosedAndAsLargeAsAStomach) {
  const Organ organ(coarse());
  EXPECT_EQ(open_edges(organ.rest()), 0U);
  // About 12 x 8 x 7 cm, give or take a third.
  const Eigen::Vector3d size = extent(organ.rest());
  EXPECT_NEAR(size.x(), 0.12, 0.04);
  EXPECT_NEAR(size.y(), 0.10, 0.04);
  EXPECT_NEAR(size.z(), 0.065, 0.02);
}

TEST(Organ, NormalsPointIntoTheCavity) {
  const Organ organ(coarse());
  std::size_t inwards = 0;
  for (std::size_t i = 0; i < organ.rest().vertices.size(); ++i) {
    const Eigen::Vector3d point = organ.rest().vertices[i].cast<double>();
    const double along = organ.centreline().nearest(point);
    const Eigen::Vector3d to_axis = organ.centreline().frame(along).centre - point;
    inwards += to_axis.dot(organ.rest().normals[i].cast<double>()) > 0;
  }
  // Flanks of steep folds may lean away from the axis, but few.
  EXPECT_GT(static_cast<double>(inwards), 0.97 * static_cast<double>(organ.rest().vertices.size()));
}

TEST(Organ, OpenedStomachHasNoRoof) {
  OrganConfiguration configuration = coarse();
  configuration.opened = true;
  const Organ organ(configuration);
  EXPECT_GT(open_edges(organ.rest()), 0U);
  constexpr double kRaggedEdge = 0.012;  // metres above the cut at most
  for (const auto& vertex : organ.rest().vertices) {
    EXPECT_LT(static_cast<double>(vertex.z()), configuration.opening_height + kRaggedEdge);
  }
}

TEST(Organ, WallMovesInwardsByTheAmplitudeAtMost) {
  OrganConfiguration configuration = coarse();
  configuration.peristalsis.amplitude = 0.004;
  const Organ organ(configuration);
  TriangleMesh wall = organ.rest();
  organ.deform(3, wall);
  double furthest = 0;
  for (std::size_t i = 0; i < wall.vertices.size(); ++i) {
    furthest = std::max(furthest,
                        static_cast<double>((wall.vertices[i] - organ.rest().vertices[i]).norm()));
  }
  constexpr double kRounding = 1e-6;  // metres, single precision
  EXPECT_LE(furthest, configuration.peristalsis.amplitude + kRounding);
  // Somewhere a crest stands in the middle of the organ.
  EXPECT_GT(furthest, 0.95 * configuration.peristalsis.amplitude);
  // One period later all is as it was.
  TriangleMesh later = organ.rest();
  organ.deform(3 + configuration.peristalsis.period, later);
  for (std::size_t i = 0; i < wall.vertices.size(); ++i) {
    EXPECT_LT((wall.vertices[i] - later.vertices[i]).norm(), kRounding);
  }
}

TEST(Organ, SeedsGiveDifferentStomachs) {
  OrganConfiguration other = coarse();
  other.seed = 1;
  EXPECT_NE(Organ(coarse()).rest().vertices, Organ(other).rest().vertices);
}

TEST(Organ, PlyHasEveryVertexAndTriangle) {
  const Organ organ(coarse());
  const std::string path = ::testing::TempDir() + "organ_test.ply";
  write_ply(path, organ.rest());
  std::ifstream file(path, std::ios::binary);
  std::string header;
  for (std::string line; std::getline(file, line) && line != "end_header";) header += line + "\n";
  EXPECT_NE(header.find("element vertex " + std::to_string(organ.rest().vertices.size())),
            std::string::npos);
  const auto body_start = static_cast<std::size_t>(file.tellg());
  EXPECT_EQ(std::filesystem::file_size(path) - body_start,
            12 * organ.rest().vertices.size() + 13 * organ.rest().triangles.size());
  std::filesystem::remove(path);
}

TEST(Organ, StomachFromCtBecomesAFineClosedCavity) {
  const char* data = std::getenv("GASTRONAUT_DATA");
  const std::filesystem::path root =
      data != nullptr ? std::filesystem::path(data)
                      : std::filesystem::path(GASTRONAUT_SOURCE_DIR) / "../shared/data";
  const std::filesystem::path mesh = root / "organ_meshes/stomach.vtk";
  if (!std::filesystem::exists(mesh)) {
    GTEST_SKIP() << "no " << mesh << ": set GASTRONAUT_DATA to the shared data";
  }
  OrganConfiguration configuration = coarse();
  configuration.mesh = mesh.string();
  const Organ organ(configuration);
  EXPECT_EQ(open_edges(organ.rest()), 0U);
  // A human stomach from CT: a few centimetres when empty, three decimetres at most.
  EXPECT_GT(extent(organ.rest()).x(), 0.05);
  EXPECT_LT(extent(organ.rest()).x(), 0.3);
  // The axis runs inside: there is wall in every direction from its middle.
  for (const double angle : {0.0, 1.57, 3.14, 4.71}) {
    EXPECT_GT(organ.centreline().radius(0.5, angle), 0.005);
  }
}

TEST(Organ, RefusesAFileThatIsNoMesh) {
  OrganConfiguration configuration = coarse();
  configuration.mesh = std::string(GASTRONAUT_SOURCE_DIR) + "/CMakeLists.txt";
  EXPECT_THROW(Organ{configuration}, ConfigurationError);
}

TEST(Organ, CardIsAFlatRectangleFacingUpWhateverIsSaidOfTissue) {
  OrganConfiguration card = coarse();
  card.shape = OrganShapeKind::kCard;
  card.width = 0.08;
  card.height = 0.05;
  card.bump_height = 0.001;
  card.peristalsis.amplitude = 0.002;
  const Organ organ(card);
  constexpr double kFloat = 1e-6;  // relative, of single precision
  EXPECT_TRUE(extent(organ.rest()).isApprox(Eigen::Vector3d(0.08, 0.05, 0), kFloat));
  for (const auto& normal : organ.rest().normals) {
    EXPECT_EQ(normal, Eigen::Vector3f::UnitZ());
  }
  EXPECT_FALSE(organ.moves());
  EXPECT_EQ(organ.configuration().vessels, 0);
  EXPECT_EQ(organ.configuration().mucus, 0);
  EXPECT_EQ(organ.configuration().variation, 0);
}

}  // namespace
}  // namespace gastronaut

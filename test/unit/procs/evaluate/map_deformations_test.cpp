#include "evaluate/map_deformations.hpp"

#include <gtest/gtest.h>

#include <fstream>
#include <limits>
#include <map>
#include <variant>
#include <vector>

namespace gastronaut::evaluation {
namespace {

const std::vector<MapDeformation> kDeformations = {
    {1000000, 3, DeformationKind::kLocalLoop, 40, 200, 0.003, 0.0005, 0.004},
    {2000000, 4, DeformationKind::kLocalLoop, 41, 210, 0.001, 0.0001, 0.002},
    {3000000, 5, DeformationKind::kGlobalLoop, 42, 220, 0.02, 0.0008, 0.025},
    {4000000, 6, DeformationKind::kLocalLoop, 43, 230, 0.002, 0.0002, 0.0025}};

std::map<std::string, double> scored(const std::vector<MapDeformation>& deformations) {
  Metrics metrics;
  set_deformation_metrics(metrics, deformations);
  std::map<std::string, double> result;
  for (const auto& [key, value] : metrics.list()) {
    const double* number = std::get_if<double>(&value);
    result[key] = number ? *number : static_cast<double>(std::get<std::int64_t>(value));
  }
  return result;
}

TEST(MapDeformationsTest, AreCountedByKindWithMediansOfWhatTheyMended) {
  const std::map<std::string, double> expected = {{"deformation.frame.count", 0},
                                                  {"deformation.local_loop.count", 3},
                                                  {"deformation.local_loop.error_before", 0.002},
                                                  {"deformation.local_loop.error_after", 0.0002},
                                                  {"deformation.local_loop.largest_move", 0.004},
                                                  {"deformation.global_loop.count", 1},
                                                  {"deformation.global_loop.error_before", 0.02},
                                                  {"deformation.global_loop.error_after", 0.0008},
                                                  {"deformation.global_loop.largest_move", 0.025}};
  EXPECT_EQ(scored(kDeformations), expected);
  EXPECT_TRUE(scored({}).empty());
}

TEST(MapDeformationsTest, AnErrorThatIsNoNumberIsLeftOut) {
  std::vector<MapDeformation> deformations = kDeformations;
  deformations[1].error_before = std::numeric_limits<double>::quiet_NaN();
  auto metrics = scored(deformations);
  EXPECT_EQ(metrics["deformation.local_loop.count"], 3);
  EXPECT_EQ(metrics["deformation.local_loop.error_before"], 0.0025);
}

TEST(MapDeformationsTest, AreListedInAFile) {
  const std::string path = testing::TempDir() + "/deformations_test.csv";
  write_deformations(path, kDeformations);
  std::ifstream file(path);
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  ASSERT_EQ(lines.size(), 1 + kDeformations.size());
  EXPECT_EQ(lines[0],
            "utime,map_version,nodes,constraints,error_before,error_after,largest_move,kind");
  EXPECT_EQ(lines[3], "3000000,5,42,220,0.02,0.0008,0.025,global_loop");
  EXPECT_THROW(write_deformations(testing::TempDir() + "/absent/deformations.csv", kDeformations),
               std::runtime_error);
}

}  // namespace
}  // namespace gastronaut::evaluation

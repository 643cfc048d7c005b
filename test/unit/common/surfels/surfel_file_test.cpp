#include "surfels/surfel_file.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

namespace gastronaut {
namespace {

// PLY as the format's description has it, for scalar properties of one element.
TEST(SurfelFile, PlyReadsBackWithNamedColumns) {
  const std::vector<Surfel> surfels = {
      {{0.01F, -0.02F, 1.03F}, {0.6F, 0, -0.8F}, {0, 128, 255}, 0.001F, 5, 0},
      {{-3, 0.1F, 0}, {0, 1, 0}, {9, 8, 7}, 0.002F, 0.5F, 0}};
  const std::string path = testing::TempDir() + "surfel_file_test.ply";
  write_surfels(path, surfels, "for a test");
  std::ifstream file(path, std::ios::binary);
  std::string line;
  std::size_t count = 0;
  std::vector<std::pair<std::string, std::string>> columns;  // type, name
  std::getline(file, line);
  ASSERT_EQ(line, "ply");
  std::getline(file, line);
  ASSERT_EQ(line, "format binary_little_endian 1.0");
  while (std::getline(file, line) && line != "end_header") {
    std::istringstream words(line);
    std::string word, type, name;
    words >> word >> type >> name;
    if (word == "element") {
      ASSERT_EQ(type, "vertex");
      count = std::stoul(name);
    } else if (word == "property") {
      columns.emplace_back(type, name);
    }
  }
  std::vector<std::string> names;
  for (const auto& column : columns) names.push_back(column.second);
  ASSERT_EQ(names, (std::vector<std::string>{"x", "y", "z", "nx", "ny", "nz", "red", "green",
                                             "blue", "radius", "confidence"}));
  std::vector<std::vector<float>> rows(count);
  for (auto& row : rows) {
    for (const auto& column : columns) {
      if (column.first == "uchar") {
        row.push_back(static_cast<float>(file.get()));
      } else {
        ASSERT_EQ(column.first, "float");
        float value = 0;
        file.read(reinterpret_cast<char*>(&value), sizeof value);
        row.push_back(value);
      }
    }
  }
  ASSERT_TRUE(file);
  EXPECT_EQ(file.get(), std::istringstream::traits_type::eof());

  std::vector<std::vector<float>> expected;
  for (const Surfel& s : surfels) {
    expected.push_back({s.position.x(), s.position.y(), s.position.z(), s.normal.x(), s.normal.y(),
                        s.normal.z(), static_cast<float>(s.colour[0]),
                        static_cast<float>(s.colour[1]), static_cast<float>(s.colour[2]), s.radius,
                        s.confidence});
  }
  EXPECT_EQ(rows, expected);
  std::filesystem::remove(path);
}

}  // namespace
}  // namespace gastronaut

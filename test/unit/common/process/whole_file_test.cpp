#include "process/whole_file.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <stdexcept>

namespace gastronaut {
namespace {

void write_text(const std::string& path, const std::string& text) {
  write_whole(path, [&text](std::ofstream& file) { file << text; });
}

TEST(WholeFile, AFileUnderItsNameIsWhole) {
  const std::string path = testing::TempDir() + "whole_file_test.txt";
  write_text(path, "first");
  write_text(path, "second");
  EXPECT_EQ(std::filesystem::file_size(path), std::string("second").size());
  EXPECT_FALSE(std::filesystem::exists(path + ".partial"));
  std::filesystem::remove(path);
  EXPECT_THROW(write_text("/no/such/folder/tree.bt", "bytes"), std::runtime_error);
}

}  // namespace
}  // namespace gastronaut

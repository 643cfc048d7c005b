#include "visual_slam/surfel_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

namespace gastronaut::slam {
namespace {

// A folder of the test's own.
class SurfelFile : public testing::Test {
 protected:
  SurfelFile() {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    folder_ = std::filesystem::temp_directory_path() / (std::string("surfel_file_") + test->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~SurfelFile() override { std::filesystem::remove_all(folder_); }

  std::string path(const std::string& name) const { return (folder_ / name).string(); }

 private:
  std::filesystem::path folder_;
};

SurfelArrays some_surfels() {
  SurfelArrays s;
  s.resize(5);
  for (std::size_t k : {0U, 1U, 3U, 4U}) {  // 2 is a gap
    const auto f = static_cast<float>(k);
    s.x[k] = 0.01F * f;
    s.y[k] = -0.02F * f;
    s.z[k] = 0.03F + f;
    s.nx[k] = 0.6F;
    s.ny[k] = 0;
    s.nz[k] = -0.8F;
    s.albedo[k] = 0.2F * f - 0.2F;
    s.confidence[k] = 5 * f;
    s.radius[k] = 0.001F;
    s.initialised[k] = 1'700'000'000'000'000 + static_cast<std::int64_t>(k);
    s.updated[k] = 1'700'000'001'000'000;
  }
  return s;
}

std::string read(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write(const std::string& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

TEST_F(SurfelFile, GivesBackWhatWasSaved) {
  for (const SurfelArrays& surfels : {some_surfels(), SurfelArrays{}}) {
    save_map(path("map"), {surfels, {}});
    EXPECT_EQ(load_map(path("map")).surfels, surfels);
    EXPECT_FALSE(std::filesystem::exists(path("map.partial")));
    save_map(path("again"), {load_map(path("map")).surfels, {}});
    EXPECT_EQ(read(path("again")), read(path("map")));
  }
}

std::vector<SE3> some_viewpoints() {
  return {{}, {so3_exp({0.1, -0.2, 0.3}), {0.01, -0.02, 1.0 / 3}}};
}

TEST_F(SurfelFile, ViewpointsComeBackToTheBit) {
  for (const SurfelArrays& surfels : {some_surfels(), SurfelArrays{}}) {
    save_map(path("map"), {surfels, some_viewpoints()});
    const KeptMap map = load_map(path("map"));
    EXPECT_EQ(map.surfels, surfels);
    ASSERT_EQ(map.viewpoints.size(), some_viewpoints().size());
    for (std::size_t k = 0; k < map.viewpoints.size(); ++k) {
      EXPECT_EQ(map.viewpoints[k].translation, some_viewpoints()[k].translation);
      EXPECT_EQ(map.viewpoints[k].rotation.coeffs(), some_viewpoints()[k].rotation.coeffs());
    }
  }
}

TEST_F(SurfelFile, ViewpointsThatAreNoPosesAreRefused) {
  SE3 stretched;
  stretched.rotation.w() = 2;
  SE3 nowhere;
  nowhere.translation.y() = std::numeric_limits<double>::quiet_NaN();
  for (const SE3& wrong : {stretched, nowhere}) {
    save_map(path("map"), {some_surfels(), {SE3{}, wrong}});
    EXPECT_THROW(load_map(path("map")), std::runtime_error);
  }
}

TEST_F(SurfelFile, CutOffAnywhereIsRefused) {
  save_map(path("map"), {some_surfels(), some_viewpoints()});
  const std::string bytes = read(path("map"));
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    write(path("cut"), bytes.substr(0, length));
    ASSERT_THROW(load_map(path("cut")).surfels, std::runtime_error) << length;
  }
  write(path("cut"), bytes + '\0');
  EXPECT_THROW(load_map(path("cut")).surfels, std::runtime_error);
}

TEST_F(SurfelFile, AnyChangedByteIsRefused) {
  save_map(path("map"), {some_surfels(), some_viewpoints()});
  const std::string bytes = read(path("map"));
  for (std::size_t k = 0; k < bytes.size(); ++k) {
    std::string changed = bytes;
    changed[k] = static_cast<char>(changed[k] ^ 0x40);
    write(path("changed"), changed);
    ASSERT_THROW(load_map(path("changed")).surfels, std::runtime_error) << k;
  }
}

TEST_F(SurfelFile, NumbersThatNoMapHoldsAreRefused) {
  SurfelArrays s = some_surfels();
  s.nx[3] = std::numeric_limits<float>::quiet_NaN();
  save_map(path("map"), {s, {}});
  EXPECT_THROW(load_map(path("map")).surfels, std::runtime_error);
  s = some_surfels();
  s.updated[0] = std::numeric_limits<std::int64_t>::min();
  save_map(path("map"), {s, {}});
  EXPECT_THROW(load_map(path("map")).surfels, std::runtime_error);
}

TEST_F(SurfelFile, ErrorsNameTheFileAndSayWhatToDo) {
  const auto message = [](const auto& call) {
    try {
      call();
    } catch (const std::runtime_error& error) {
      return std::string(error.what());
    }
    return std::string("no error");
  };
  write(path("photo.png"), "\x89PNG, longer than a header of a map of surfels");
  EXPECT_THAT(message([&] { load_map(path("photo.png")).surfels; }),
              testing::AllOf(testing::HasSubstr("photo.png"), testing::HasSubstr("is not a map"),
                             testing::HasSubstr("give a map that visual_slam saved")));
  EXPECT_THAT(message([&] { load_map(path("none")).surfels; }),
              testing::HasSubstr("cannot be read"));
  EXPECT_THAT(message([&] {
                save_map(path("no/such/folder"), {{}, {}});
              }),
              testing::HasSubstr("check the folder"));
}

TEST_F(SurfelFile, FailedSaveLeavesTheOldMap) {
  save_map(path("map"), {some_surfels(), {}});
  std::filesystem::create_directory(path("map.partial"));  // cannot be opened as a file
  EXPECT_THROW(save_map(path("map"), {{}, {}}), std::runtime_error);
  EXPECT_EQ(load_map(path("map")).surfels, some_surfels());
}

TEST_F(SurfelFile, ScaleComesBackAndNonsenseIsRefused) {
  constexpr double kScale = 1.0 / 3;
  save_map(path("map"), {some_surfels(), some_viewpoints(), kScale});
  EXPECT_EQ(load_map(path("map")).depth_scale, kScale);
  for (const double wrong : {-1.0, std::numeric_limits<double>::quiet_NaN()}) {
    save_map(path("map"), {some_surfels(), some_viewpoints(), wrong});
    EXPECT_THROW(load_map(path("map")), std::runtime_error);
  }
}

}  // namespace
}  // namespace gastronaut::slam

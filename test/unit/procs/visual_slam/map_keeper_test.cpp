#include "visual_slam/map_keeper.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>

namespace gastronaut::slam {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class MapKeeperTest : public ::testing::Test {
 protected:
  MapKeeperTest() {
    const auto* test = testing::UnitTest::GetInstance()->current_test_info();
    folder_ = std::filesystem::temp_directory_path() / (std::string("map_keeper_") + test->name());
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_);
  }
  ~MapKeeperTest() override { std::filesystem::remove_all(folder_); }
  std::string path(const std::string& name = "map") const { return (folder_ / name).string(); }

 private:
  std::filesystem::path folder_;
};

KeptMap map_of(std::size_t surfels) {
  KeptMap map;
  map.surfels.resize(surfels);
  for (std::size_t k = 0; k < surfels; ++k) {
    map.surfels.z[k] = 0.03F;
    map.surfels.nz[k] = -1;
    map.surfels.radius[k] = 1e-3F;
  }
  map.viewpoints.push_back({Eigen::Quaterniond::Identity(), {0.001, 0.002, 0.003}});
  return map;
}

TEST_F(MapKeeperTest, WritesWhatItWasGiven) {
  MapKeeper keeper(path());
  EXPECT_TRUE(keeper.save(map_of(100)));
  keeper.wait();
  EXPECT_THAT(keeper.problem(), IsEmpty());
  EXPECT_EQ(load_map(path()).surfels, map_of(100).surfels);
  EXPECT_TRUE(keeper.save(map_of(200)));
  keeper.wait();
  EXPECT_EQ(load_map(path()).surfels.size(), 200U);
}

TEST_F(MapKeeperTest, FileIsWholeWheneverItIsThere) {
  MapKeeper keeper(path());
  constexpr int kSnapshots = 20;
  int taken = 0;
  for (std::size_t k = 1; k <= kSnapshots; ++k) {
    taken += keeper.save(map_of(10'000 * k)) ? 1 : 0;
    if (std::filesystem::exists(path())) {
      EXPECT_NO_THROW(load_map(path()));
    }
  }
  EXPECT_GE(taken, 1);
  keeper.wait();
  EXPECT_NO_THROW(load_map(path()));
}

TEST_F(MapKeeperTest, WaitsForWhatIsBeingWrittenWhenItGoes) {
  { MapKeeper(path()).save(map_of(100'000)); }
  EXPECT_EQ(load_map(path()).surfels.size(), 100'000U);
}

TEST_F(MapKeeperTest, FailureIsToldUntilASaveSucceeds) {
  MapKeeper keeper(path("folder/map"));
  keeper.save(map_of(10));
  keeper.wait();
  EXPECT_THAT(keeper.problem(), AllOf(HasSubstr("folder/map"), HasSubstr("check the folder")));
  EXPECT_THAT(keeper.problem(), HasSubstr("folder/map"));  // again
  std::filesystem::create_directory(path("folder"));
  keeper.save(map_of(10));
  keeper.wait();
  EXPECT_THAT(keeper.problem(), IsEmpty());
}

TEST_F(MapKeeperTest, FullDiskIsToldAndTheOldMapKept) {
  if (!std::filesystem::exists("/dev/full")) GTEST_SKIP() << "needs /dev/full";
  MapKeeper keeper(path());
  keeper.save(map_of(10));
  keeper.wait();
  std::filesystem::create_symlink("/dev/full", path("map.partial"));
  keeper.save(map_of(20'000));
  keeper.wait();
  EXPECT_THAT(keeper.problem(), HasSubstr("No space left"));
  EXPECT_EQ(load_map(path()).surfels, map_of(10).surfels);
}

}  // namespace
}  // namespace gastronaut::slam

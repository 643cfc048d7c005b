#include "occupancy_mapper/occupancy_mapper_process.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <octomap/OcTree.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <memory>
#include <sstream>

#include "bus/memory_bus.hpp"
#include "gastronaut/occupancy_t.hpp"
#include "process/channels.hpp"
#include "unit/procs/occupancy_mapper/occupancy_scene.hpp"

namespace gastronaut {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

constexpr std::int64_t kPeriod = 100'000;  // microseconds between two pictures
constexpr std::int64_t kFirst = 1'700'000'000'000'000;
constexpr int kPicturesAMap = 5;  // two MAP_SURFELS a second
constexpr float kStable = 10;
constexpr double kWallDistance = 0.0305;
constexpr double kWallSide = 0.01;

std::int64_t utime_of(int picture) { return kFirst + picture * kPeriod; }

visual_pose_t pose(int picture, int map_version = 1) {
  visual_pose_t message{};
  message.utime = utime_of(picture);
  message.map_version = map_version;
  message.status = visual_pose_t::STATUS_OK;
  message.orientation[0] = 1;
  return message;
}

void add(map_surfels_t& message, const occupancy::MapSurfel& surfel, float confidence) {
  message.id.push_back(surfel.id);
  message.x.push_back(surfel.position.x());
  message.y.push_back(surfel.position.y());
  message.z.push_back(surfel.position.z());
  message.nx.push_back(surfel.normal.x());
  message.ny.push_back(surfel.normal.y());
  message.nz.push_back(surfel.normal.z());
  message.red.push_back(0);
  message.green.push_back(0);
  message.blue.push_back(0);
  message.radius.push_back(1e-3F);
  message.confidence.push_back(confidence);
  message.num_surfels = static_cast<std::int32_t>(message.id.size());
}

map_surfels_t surfels(int picture, const std::vector<occupancy::MapSurfel>& wall,
                      float confidence = kStable) {
  map_surfels_t message{};
  message.utime = utime_of(picture);
  message.map_version = 1;
  message.reset = picture == 0 ? 1 : 0;
  for (const occupancy::MapSurfel& each : wall) add(message, each, confidence);
  return message;
}

std::string header(const std::string& bytes) { return bytes.substr(0, bytes.find("\ndata\n")); }

std::string contents(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

std::unique_ptr<octomap::OcTree> read(const std::string& bytes) {
  std::istringstream stream(bytes);
  auto tree = std::make_unique<octomap::OcTree>(1);
  return tree->readBinary(stream) ? std::move(tree) : nullptr;
}

// The process on a bus of its own, and what it published.
class Mapper {
 public:
  explicit Mapper(const std::string& file = {}, const RigConfiguration& rig = {})
      : bus_(&network_.connect()), process_(*bus_, rig, file) {}

  template <class Message>
  void inject(const char* channel, const Message& message) {
    inject_bytes(channel, encode_message(message));
  }
  void inject_bytes(const char* channel, const std::vector<std::uint8_t>& bytes) {
    network_.inject(channel, bytes);
    network_.run_until_idle();
  }
  // Pictures from `begin` to before `end`, of the same wall.
  void look_at(const std::vector<occupancy::MapSurfel>& wall, int begin, int end) {
    for (int i = begin; i < end; ++i) {
      inject(channel::kVisualPose, pose(i));
      if (i % kPicturesAMap == 0) inject(channel::kMapSurfels, surfels(i, wall));
    }
  }
  void end() {
    network_.finish([this](std::size_t) { process_.finish(); });
  }

  const Bus& bus() const { return *bus_; }
  const std::vector<occupancy_t>& trees() const { return trees_; }
  std::string bytes(std::size_t i) const { return {trees_[i].data.begin(), trees_[i].data.end()}; }
  std::string last() const { return bytes(trees_.size() - 1); }

 private:
  std::vector<occupancy_t> trees_;
  MemoryNetwork network_{[this](const std::string& channel, Bytes payload, std::int64_t) {
    ASSERT_EQ(channel, channel::kOctomap);
    ASSERT_EQ(decode_message(payload, trees_.emplace_back()), DecodeResult::kOk);
  }};
  Bus* bus_;
  OccupancyMapperProcess process_;
};

const std::vector<occupancy::MapSurfel>& wall() {
  static const auto result = occupancy::plate(kWallDistance, kWallSide);
  return result;
}

TEST(OccupancyMapperProcessTest, ATreeASecondOfTheMapAsItWasThen) {
  Mapper run;
  run.look_at(wall(), 0, 28);
  run.end();
  std::vector<std::int64_t> pictures;
  for (const occupancy_t& tree : run.trees()) {
    pictures.push_back((tree.utime - kFirst) / kPeriod);
    EXPECT_EQ(tree.map_version, 1);
    EXPECT_EQ(tree.format, static_cast<int>(occupancy_t::FORMAT_BT));
    EXPECT_EQ(tree.resolution, occupancy::kResolution);
  }
  // The last for the end: with all that came since.
  EXPECT_THAT(pictures, ElementsAre(0, 10, 20, 25));
  EXPECT_EQ(run.bus().state(), ProcessState::kRunning);
}

TEST(OccupancyMapperProcessTest, OctomapReadsOccupiedFreeAndUnknown) {
  Mapper run;
  run.look_at(wall(), 0, 10);
  run.end();
  const auto tree = read(run.last());
  ASSERT_NE(tree, nullptr);
  for (const occupancy::MapSurfel& each : wall()) {
    const auto* node = tree->search(each.position.x(), each.position.y(), each.position.z());
    ASSERT_NE(node, nullptr);
    ASSERT_TRUE(tree->isNodeOccupied(node));
  }
  const auto* free = tree->search(0, 0, kWallDistance / 2);
  ASSERT_NE(free, nullptr);
  EXPECT_FALSE(tree->isNodeOccupied(free));
  EXPECT_EQ(tree->search(0, 0, kWallDistance + 2 * occupancy::kResolution), nullptr);
  EXPECT_EQ(tree->search(0, 0, -kWallDistance), nullptr);
}

TEST(OccupancyMapperProcessTest, ClearanceAndCoverageStandInTheHeaderAndInTheStatus) {
  Mapper run;
  run.look_at(wall(), 0, 10);
  run.end();
  // The wall fills the voxels from 30 to 31 mm.
  EXPECT_THAT(header(run.last()), HasSubstr("\n# clearance 0.03\n"));
  EXPECT_THAT(header(run.last()), HasSubstr("\n# coverage 0."));
  EXPECT_THAT(header(run.last()), HasSubstr("\n# map_version 1\n"));
  EXPECT_THAT(run.bus().describe_health(), HasSubstr("clearance 30.0 mm"));
  EXPECT_THAT(run.bus().describe_health(), HasSubstr("% of the wall seen"));
}

TEST(OccupancyMapperProcessTest, SameMessagesSameBytes) {
  Mapper first;
  Mapper second;
  for (Mapper* run : {&first, &second}) {
    run->look_at(wall(), 0, 30);
    run->end();
  }
  ASSERT_EQ(first.trees().size(), second.trees().size());
  for (std::size_t i = 0; i < first.trees().size(); ++i) {
    EXPECT_EQ(first.bytes(i), second.bytes(i));
  }
}

TEST(OccupancyMapperProcessTest, UnstableSurfelsAreNoWall) {
  RigConfiguration rig;
  Mapper run({}, rig);
  run.inject(channel::kVisualPose, pose(0));
  const auto below = static_cast<float>(rig.visual_slam.stable_confidence / 2);
  run.inject(channel::kMapSurfels, surfels(0, wall(), below));
  run.end();
  EXPECT_EQ(read(run.last())->size(), 0U);
}

TEST(OccupancyMapperProcessTest, RemovedSurfelsAndResetsTakeTheirWallAway) {
  for (const bool reset : {false, true}) {
    Mapper run;
    run.look_at(wall(), 0, 10);
    map_surfels_t message = surfels(10, {});
    message.reset = reset ? 1 : 0;
    if (!reset) {
      for (const occupancy::MapSurfel& each : wall()) message.removed.push_back(each.id);
      message.num_removed = static_cast<std::int32_t>(message.removed.size());
    }
    run.inject(channel::kVisualPose, pose(10));
    run.inject(channel::kMapSurfels, message);
    run.end();
    EXPECT_GT(read(run.bytes(0))->size(), 0U);
    EXPECT_EQ(read(run.last())->size(), 0U) << reset;
  }
}

TEST(OccupancyMapperProcessTest, TheFileIsKeptAndOctomapsToolReadsIt) {
  const std::string path = testing::TempDir() + "occupancy_mapper_process_test.bt";
  {
    Mapper run(path);
    run.look_at(wall(), 0, 10);
    // Already while it runs, and once more at the end.
    EXPECT_TRUE(std::filesystem::exists(path));
    run.end();
    EXPECT_EQ(contents(path), run.last());
  }
  if (std::system("command -v bt2vrml >/dev/null") != 0) {
    GTEST_SKIP() << "bt2vrml is not there: install octomap-tools";
  }
  ASSERT_EQ(std::system(("bt2vrml '" + path + "' >/dev/null 2>&1").c_str()), 0);
  // One box for each voxel of the wall.
  const auto tree = read(contents(path));
  tree->expand();
  std::size_t occupied = 0;
  for (auto leaf = tree->begin_leafs(); leaf != tree->end_leafs(); ++leaf) {
    occupied += tree->isNodeOccupied(*leaf) ? 1 : 0;
  }
  const std::string model = contents(path + ".wrl");
  std::size_t boxes = 0;
  for (auto at = model.find("translation"); at != std::string::npos;
       at = model.find("translation", at + 1)) {
    ++boxes;
  }
  EXPECT_EQ(boxes, occupied);
  std::filesystem::remove(path);
  std::filesystem::remove(path + ".wrl");
}

TEST(OccupancyMapperProcessTest, TheOtherFormatHoldsTheSameTree) {
  const std::string path = testing::TempDir() + "occupancy_mapper_process_test.ot";
  Mapper run(path);
  run.look_at(wall(), 0, 10);
  run.end();
  const std::unique_ptr<octomap::AbstractOcTree> any(octomap::AbstractOcTree::read(path));
  const auto* tree = dynamic_cast<octomap::OcTree*>(any.get());
  ASSERT_NE(tree, nullptr);
  EXPECT_EQ(tree->size(), read(run.last())->size());
  std::filesystem::remove(path);
}

TEST(OccupancyMapperProcessTest, AFileThatCannotBeWrittenIsNamed) {
  Mapper run("/no/such/folder/map.bt");
  run.look_at(wall(), 0, 10);
  EXPECT_EQ(run.bus().state(), ProcessState::kDegraded);
  EXPECT_THAT(run.bus().describe_health(), HasSubstr("/no/such/folder/map.bt: cannot be written"));
  run.end();
}

TEST(OccupancyMapperProcessTest, WithoutPosesItSaysThatFreeSpaceIsNotKnown) {
  Mapper run;
  for (int i = 0; i < 30; i += kPicturesAMap) {
    visual_pose_t lost = pose(i);
    lost.status = visual_pose_t::STATUS_LOST;
    run.inject(channel::kVisualPose, lost);
    run.inject(channel::kMapSurfels, surfels(i, wall()));
  }
  run.end();
  EXPECT_EQ(run.bus().state(), ProcessState::kDegraded);
  EXPECT_THAT(run.bus().describe_health(), HasSubstr("free space is not known there"));
  EXPECT_THAT(header(run.last()), Not(HasSubstr("coverage")));
  EXPECT_THAT(header(run.last()), Not(HasSubstr("clearance")));
}

TEST(OccupancyMapperProcessTest, StartedLaterThanTheMapItSaysSo) {
  Mapper run;
  run.look_at(wall(), 5, 15);
  EXPECT_EQ(run.bus().state(), ProcessState::kDegraded);
  EXPECT_THAT(run.bus().describe_health(), HasSubstr("before this process listened"));
  map_surfels_t message = surfels(15, wall());
  message.reset = 1;
  run.inject(channel::kVisualPose, pose(15));
  run.inject(channel::kMapSurfels, message);
  run.end();
  EXPECT_EQ(run.bus().state(), ProcessState::kRunning);
}

TEST(OccupancyMapperProcessTest, SilentInputsAreNamed) {
  Mapper run;
  run.look_at(wall(), 0, 10);
  for (int i = 10; i < 60; ++i) run.inject(channel::kVisualPose, pose(i));
  EXPECT_THAT(run.bus().describe_health(), HasSubstr(channel::kMapSurfels));
  run.end();
}

TEST(OccupancyMapperProcessTest, ImpossibleNumbersNeitherCrashItNorComeOut) {
  constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
  Mapper run;
  run.look_at(wall(), 0, 10);
  const std::string before = run.last();
  map_surfels_t message = surfels(10, {wall()[0], wall()[0], wall()[1], wall()[2], wall()[3]});
  message.id[2] = std::numeric_limits<std::int32_t>::min();
  message.x[3] = kNaN;
  message.z[4] = -std::numeric_limits<float>::infinity();
  message.removed = {-1, std::numeric_limits<std::int32_t>::max(), 1'000'000};
  message.num_removed = static_cast<std::int32_t>(message.removed.size());
  visual_pose_t broken = pose(10);
  broken.position[1] = std::numeric_limits<double>::quiet_NaN();
  run.inject(channel::kVisualPose, broken);
  run.inject(channel::kMapSurfels, message);
  visual_pose_t no_rotation = pose(11);
  no_rotation.orientation[0] = 0;
  run.inject(channel::kVisualPose, no_rotation);
  run.end();
  EXPECT_THAT(run.bus().describe_health(), HasSubstr("3 surfels of MAP_SURFELS left out"));
  const auto payload = [](const std::string& bytes) { return bytes.substr(header(bytes).size()); };
  EXPECT_EQ(payload(run.last()), payload(before));
}

TEST(OccupancyMapperProcessTest, AMessageThatClaimsMoreThanItHasIsDropped) {
  Mapper run;
  std::vector<std::uint8_t> bytes = encode_message(surfels(0, wall()));
  bytes.resize(bytes.size() / 2);
  run.inject_bytes(channel::kMapSurfels, bytes);
  bytes = encode_message(surfels(1, {wall()[0]}));
  // num_surfels follows fingerprint, utime, map_version and reset, highest byte first.
  constexpr std::size_t kCount = 8 + 8 + 4 + 1;
  bytes[kCount] = 0x7F;
  run.inject_bytes(channel::kMapSurfels, bytes);
  run.end();
  EXPECT_EQ(run.bus().counters().corrupt, 2);
  EXPECT_THAT(run.trees(), IsEmpty());
}

}  // namespace
}  // namespace gastronaut

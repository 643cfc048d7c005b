#include "bus/log_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

namespace gastronaut {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

class LogFileTest : public ::testing::Test {
 protected:
  void SetUp() override {
    directory_ = std::filesystem::path(::testing::TempDir()) /
                 (std::string("log_file_test_") +
                  ::testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(directory_);
    std::filesystem::create_directories(directory_);
    path_ = (directory_ / "test.lcmlog").string();
  }
  void TearDown() override { std::filesystem::remove_all(directory_); }

  void write_poses(int count) {
    LogWriter writer(path_);
    for (int i = 0; i < count; ++i) {
      rigid_transform_t pose{};
      pose.utime = 1000 + i;
      pose.quat[0] = 1;
      writer.write("GROUND_TRUTH_POSE", pose);
    }
    writer.close();
  }
  int count_events(std::string* damage = nullptr) {
    LogReader reader(path_);
    int count = 0;
    while (reader.next()) ++count;
    if (damage != nullptr) *damage = reader.damage();
    return count;
  }
  void overwrite(std::uint64_t offset, const std::string& bytes) {
    std::fstream file(path_, std::ios::in | std::ios::out | std::ios::binary);
    file.seekp(static_cast<std::streamoff>(offset));
    file << bytes;
  }

  static constexpr std::uint64_t kEventSize = 28 + 17 + 8 + 8 + 7 * 8;  // header, channel, payload
  std::filesystem::path directory_;
  std::string path_;
};

TEST_F(LogFileTest, ReadsBackWhatWasWritten) {
  write_poses(3);
  LogReader reader(path_);
  for (int i = 0; i < 3; ++i) {
    const auto event = reader.next();
    ASSERT_TRUE(event);
    EXPECT_EQ(event->channel, "GROUND_TRUTH_POSE");
    EXPECT_EQ(event->log_utime, 1000 + i);
    rigid_transform_t pose;
    EXPECT_EQ(decode_message(event->payload, pose), DecodeResult::kOk);
    EXPECT_EQ(pose.utime, 1000 + i);
  }
  EXPECT_FALSE(reader.next());
  EXPECT_THAT(reader.damage(), IsEmpty());
}

TEST_F(LogFileTest, StockLibraryReadsOurLogs) {
  write_poses(3);
  lcm::LogFile stock(path_, "r");
  int count = 0;
  while (stock.readNextEvent() != nullptr) ++count;
  EXPECT_EQ(count, 3);
}

TEST_F(LogFileTest, TruncatedLogGivesEverythingBeforeTheCutAndItsOffset) {
  write_poses(3);
  for (const std::uint64_t kept : {std::uint64_t{5}, std::uint64_t{40}, kEventSize - 1}) {
    write_poses(3);
    std::filesystem::resize_file(path_, 2 * kEventSize + kept);
    std::string damage;
    EXPECT_EQ(count_events(&damage), 2);
    EXPECT_THAT(damage, HasSubstr("offset " + std::to_string(2 * kEventSize)));
  }
}

TEST_F(LogFileTest, GarbageInTheMiddleKeepsTheEventBeforeIt) {
  write_poses(3);
  overwrite(kEventSize, "garbage");
  std::string damage;
  EXPECT_EQ(count_events(&damage), 1);
  EXPECT_THAT(damage, HasSubstr("offset " + std::to_string(kEventSize)));
}

TEST_F(LogFileTest, ImpossibleLengthsAreDamageNotMemory) {
  constexpr std::uint64_t kDataLengthAt = 24;
  write_poses(2);
  overwrite(kDataLengthAt, "\x7f\xff\xff\xff");
  std::string damage;
  EXPECT_EQ(count_events(&damage), 0);
  EXPECT_THAT(damage, HasSubstr("beyond the end"));
}

TEST_F(LogFileTest, UnfinishedLogStaysUnderItsPartialName) {
  {
    LogWriter writer(path_);
    writer.write("A", rigid_transform_t{});
  }
  EXPECT_FALSE(std::filesystem::exists(path_));
  EXPECT_TRUE(std::filesystem::exists(path_ + ".partial"));
}

TEST_F(LogFileTest, FullDiskIsAnError) {
  std::filesystem::create_symlink("/dev/full", path_ + ".partial");
  LogWriter writer(path_);
  EXPECT_THROW(
      {
        writer.write("A", rigid_transform_t{});
        writer.close();
      },
      std::runtime_error);
}

TEST_F(LogFileTest, MissingFileAndFolderAreErrors) {
  EXPECT_THROW(LogReader reader(path_), std::runtime_error);
  EXPECT_THROW(LogReader reader(directory_.string()), std::runtime_error);
  EXPECT_THROW(LogWriter writer((directory_ / "no" / "such.lcmlog").string()), std::runtime_error);
}

TEST_F(LogFileTest, EmptyLogHasNoEventsAndNoDamage) {
  std::ofstream(path_).close();
  std::string damage;
  EXPECT_EQ(count_events(&damage), 0);
  EXPECT_THAT(damage, IsEmpty());
}

}  // namespace
}  // namespace gastronaut

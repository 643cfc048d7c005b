#include "process/log_run.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <map>

#include "bus/log_file.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;

// Answers each Hall reading with a fix at (noise, number of sensors, 0): shows which configuration
// and which readings it saw.
class EchoProcess : public Process {
 public:
  EchoProcess(Bus& bus, const RigConfiguration& configuration) {
    bus.subscribe<hall_array_t>(channel::kHallArray, configuration.lag.hall_array,
                                [&bus, noise = configuration.hall_array.noise](const auto& m) {
                                  magnetic_pose_t pose{};
                                  pose.utime = m.utime;
                                  pose.seq = m.seq;
                                  pose.position[0] = noise;
                                  bus.publish(channel::kMagneticPose, pose);
                                });
  }
};

ProcessDescription echo() {
  return {"echo",
          "Echoes.",
          channel::kHallArray,
          [](const RigConfiguration&) { return std::vector<std::string>{channel::kMagneticPose}; },
          [](Bus& bus, const RigConfiguration& c) { return std::make_unique<EchoProcess>(bus, c); },
          {}};
}

class LogRunTest : public ::testing::Test {
 protected:
  void SetUp() override {
    directory_ = std::filesystem::path(::testing::TempDir()) /
                 (std::string("log_run_test_") +
                  ::testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(directory_);
    std::filesystem::create_directories(directory_);
    options_.log_in = (directory_ / "raw.lcmlog").string();
    options_.log_out = (directory_ / "derived.lcmlog").string();
  }
  void TearDown() override { std::filesystem::remove_all(directory_); }

  void write_raw(bool with_configuration = true) {
    LogWriter writer(options_.log_in);
    if (with_configuration) {
      rig_config_t configuration{};
      configuration.utime = 1;
      configuration.yaml = "name: recorded\nhall_array: {noise: 3 uT}\n";
      writer.write(channel::kRigConfig, configuration);
    }
    for (int i = 0; i < kReadings; ++i) {
      hall_array_t reading{};
      reading.utime = 10 + i;
      reading.seq = i;
      writer.write(channel::kHallArray, reading);
      magnetic_pose_t stale{};
      stale.utime = 10 + i;
      stale.position[0] = 1e3;
      writer.write(channel::kMagneticPose, stale);
      image_t picture{};
      picture.utime = 10 + i;
      writer.write(channel::kCamera, picture);
      process_status_t status{};
      status.utime = 10 + i;
      writer.write(channel::kProcessStatus, status);
    }
    writer.close();
  }
  std::map<std::string, int> count_derived() {
    std::map<std::string, int> counts;
    LogReader reader(options_.log_out);
    while (const auto event = reader.next()) {
      ++counts[event->channel];
      magnetic_pose_t pose;
      if (event->channel == channel::kMagneticPose &&
          decode_message(event->payload, pose) == DecodeResult::kOk) {
        noise_seen_ = pose.position[0];
      }
      rig_config_t configuration;
      if (event->channel == channel::kRigConfig &&
          decode_message(event->payload, configuration) == DecodeResult::kOk) {
        yaml_ = configuration.yaml;
      }
    }
    return counts;
  }

  static constexpr int kReadings = 5;
  std::filesystem::path directory_;
  LogRunOptions options_;
  double noise_seen_ = 0;
  std::string yaml_;
};

TEST_F(LogRunTest, CarriesTheRawChannelsAlongAndReplacesWhatItDerives) {
  write_raw();
  const LogRunResult result = run_on_log({echo()}, options_, {});
  auto counts = count_derived();
  EXPECT_EQ(counts[channel::kHallArray], kReadings);
  EXPECT_EQ(counts[channel::kCamera], kReadings);
  EXPECT_EQ(counts[channel::kMagneticPose], kReadings);
  EXPECT_EQ(counts[channel::kProcessStatus], 0);
  EXPECT_DOUBLE_EQ(noise_seen_, 3e-6);
  EXPECT_EQ(result.processes.at(0).events, kReadings);
  EXPECT_THAT(result.damage, IsEmpty());
}

TEST_F(LogRunTest, PicturesStayOutWhenNotAskedFor) {
  write_raw();
  options_.keep_images = false;
  run_on_log({echo()}, options_, {});
  EXPECT_EQ(count_derived()[channel::kCamera], 0);
}

TEST_F(LogRunTest, SettingsGoIntoTheProcessAndIntoTheDerivedLog) {
  write_raw();
  options_.settings = {"hall_array.noise=5 uT"};
  run_on_log({echo()}, options_, {});
  EXPECT_EQ(count_derived()[channel::kRigConfig], 1);
  EXPECT_DOUBLE_EQ(noise_seen_, 5e-6);
  EXPECT_DOUBLE_EQ(parse_rig_configuration(yaml_, "derived").hall_array.noise, 5e-6);
  EXPECT_EQ(parse_rig_configuration(yaml_, "derived").name, "recorded");
}

TEST_F(LogRunTest, LogWithoutConfigurationAsksForOne) {
  write_raw(false);
  try {
    run_on_log({echo()}, options_, {});
    FAIL() << "ran without a configuration";
  } catch (const ConfigurationError& error) {
    EXPECT_THAT(error.what(), HasSubstr("--config"));
  }
  EXPECT_FALSE(std::filesystem::exists(options_.log_out));
}

TEST_F(LogRunTest, DamagedLogIsUsedUpToTheDamage) {
  write_raw();
  std::filesystem::resize_file(options_.log_in, std::filesystem::file_size(options_.log_in) - 3);
  const LogRunResult result = run_on_log({echo()}, options_, {});
  EXPECT_THAT(result.damage, HasSubstr("damaged at offset"));
  EXPECT_EQ(count_derived()[channel::kMagneticPose], kReadings);
}

TEST_F(LogRunTest, OutputsStayWhereTheLogHasNothingToDeriveThemFrom) {
  {
    LogWriter writer(options_.log_in);
    rig_config_t configuration{};
    configuration.yaml = "name: recorded\n";
    writer.write(channel::kRigConfig, configuration);
    for (int i = 0; i < kReadings; ++i) {
      magnetic_pose_t derived{};
      derived.utime = 10 + i;
      writer.write(channel::kMagneticPose, derived);
    }
    writer.close();
  }
  run_on_log({echo()}, options_, {});
  EXPECT_EQ(count_derived()[channel::kMagneticPose], kReadings);
}

}  // namespace
}  // namespace gastronaut

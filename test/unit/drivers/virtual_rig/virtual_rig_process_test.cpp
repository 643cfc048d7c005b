#include "virtual_rig/virtual_rig_process.hpp"

#include <gtest/gtest.h>

#include <gastronaut/coil_currents_t.hpp>
#include <gastronaut/hall_array_t.hpp>
#include <gastronaut/image_t.hpp>
#include <gastronaut/rig_config_t.hpp>
#include <map>

#include "bus/wire.hpp"
#include "numerics/parallel.hpp"
#include "process/channels.hpp"
#include "small_scenario.hpp"

namespace gastronaut {
namespace {

constexpr std::int64_t kStart = 1'700'000'000'000'000;

struct Message {
  std::string channel;
  std::vector<std::uint8_t> payload;
  std::int64_t utime;
  bool operator==(const Message&) const = default;
};

std::vector<Message> play(const VirtualRigScenario& scenario) {
  std::vector<Message> messages;
  VirtualRigProcess rig(
      scenario, kStart,
      [&](const std::string& channel, std::vector<std::uint8_t> payload, std::int64_t utime) {
        messages.push_back({channel, std::move(payload), utime});
      });
  while (rig.next_time() < scenario.duration) rig.step();
  return messages;
}

std::map<std::string, int> count(const std::vector<Message>& messages) {
  std::map<std::string, int> counts;
  for (const Message& message : messages) ++counts[message.channel];
  return counts;
}

template <class Type>
std::vector<Type> decode(const std::vector<Message>& messages, const char* channel) {
  std::vector<Type> decoded;
  for (const Message& message : messages) {
    if (message.channel != channel) continue;
    decoded.emplace_back();
    EXPECT_EQ(decode_message(message.payload, decoded.back()), DecodeResult::kOk);
  }
  return decoded;
}

class VirtualRigProcessTest : public ::testing::Test {
 protected:
  ~VirtualRigProcessTest() override { set_thread_count(0); }
};

TEST_F(VirtualRigProcessTest, SameSeedGivesSameBytesWhateverTheThreads) {
  VirtualRigScenario scenario = small_scenario();
  scenario.organ.peristalsis.amplitude = 0.004;
  scenario.rig.camera.auto_exposure = true;
  set_thread_count(1);
  const std::vector<Message> one = play(scenario);
  set_thread_count(2);
  const std::vector<Message> two = play(scenario);
  EXPECT_TRUE(one == two);
  scenario.seed += 1;
  EXPECT_FALSE(one == play(scenario));
}

TEST_F(VirtualRigProcessTest, EveryChannelComesAtItsRateInTheOrderOfUtime) {
  const VirtualRigScenario scenario = small_scenario();
  const std::vector<Message> messages = play(scenario);
  std::map<std::string, int> counts = count(messages);
  EXPECT_EQ(counts[channel::kRigConfig], 1);
  EXPECT_EQ(counts[channel::kHallArray], 100);
  EXPECT_EQ(counts[channel::kCoilCurrents], 100);
  EXPECT_EQ(counts[channel::kCamera], 20);
  EXPECT_EQ(counts[channel::kGroundTruthPose], 20);
  EXPECT_EQ(counts[channel::kGroundTruthDepth], 20);
  for (std::size_t i = 1; i < messages.size(); ++i) {
    EXPECT_GE(messages[i].utime, messages[i - 1].utime);
  }
  EXPECT_EQ(messages.front().channel, channel::kRigConfig);
  EXPECT_EQ(messages.front().utime, kStart);
}

TEST_F(VirtualRigProcessTest, RigConfigurationIsRepeatedAndReadsBack) {
  VirtualRigScenario scenario = small_scenario();
  scenario.imaging.enabled = false;
  scenario.duration = 20.5;
  const auto configurations = decode<rig_config_t>(play(scenario), channel::kRigConfig);
  ASSERT_EQ(configurations.size(), 3U);  // at 0, 10 and 20 s
  const RigConfiguration rig = parse_rig_configuration(configurations[2].yaml, "RIG_CONFIG");
  EXPECT_EQ(rig.camera.width, scenario.rig.camera.width);
  EXPECT_EQ(rig.coils.tesla_per_ampere.rows(), 192);
  EXPECT_EQ(rig.coils.tesla_per_ampere.cols(), 9);
}

TEST_F(VirtualRigProcessTest, PicturesTellTheirNumberExposureAndGain) {
  VirtualRigScenario scenario = small_scenario();
  scenario.duration = 0.1;
  const auto pictures = decode<image_t>(play(scenario), channel::kCamera);
  ASSERT_EQ(pictures.size(), 2U);
  std::map<std::string, std::string> metadata;
  for (const image_metadata_t& entry : pictures[1].metadata) {
    metadata[entry.key] = std::string(entry.value.begin(), entry.value.end());
  }
  EXPECT_EQ(metadata["seq"], "1");
  EXPECT_EQ(metadata["exposure_us"], "4000");
  EXPECT_EQ(metadata["gain"], "1");
  EXPECT_EQ(pictures[1].utime, kStart + 50'000);
  EXPECT_EQ(pictures[1].pixelformat, image_t::PIXEL_FORMAT_MJPEG);
}

TEST_F(VirtualRigProcessTest, LostMessagesLeaveAGapInSeq) {
  VirtualRigScenario scenario = small_scenario();
  scenario.imaging.enabled = false;
  FaultConfiguration fault;
  fault.kind = FaultKind::kLostMessages;
  fault.start = 0.2;
  fault.end = 0.3;
  fault.channel = channel::kHallArray;
  fault.strength = 1;
  scenario.faults = {fault};
  const std::vector<Message> messages = play(scenario);
  const auto readings = decode<hall_array_t>(messages, channel::kHallArray);
  EXPECT_EQ(readings.size(), 90U);
  EXPECT_EQ(readings[19].seq, 19);
  EXPECT_EQ(readings[20].seq, 30);
  EXPECT_EQ(count(messages)[channel::kCoilCurrents], 100);
}

TEST_F(VirtualRigProcessTest, FaultySensorsShowInTheMessages) {
  VirtualRigScenario scenario = small_scenario();
  scenario.imaging.enabled = false;
  FaultConfiguration fault;
  fault.start = 0.5;
  fault.end = 1;
  fault.kind = FaultKind::kSaturatedSensor;
  fault.sensors = {1};
  scenario.faults.push_back(fault);
  fault.kind = FaultKind::kStaleSensor;
  fault.sensors = {2};
  scenario.faults.push_back(fault);
  fault.kind = FaultKind::kStuckSensor;
  fault.sensors = {3};
  scenario.faults.push_back(fault);
  const auto readings = decode<hall_array_t>(play(scenario), channel::kHallArray);
  EXPECT_EQ(readings[80].status[0], hall_array_t::STATUS_OK);
  EXPECT_EQ(readings[80].status[1], hall_array_t::STATUS_SATURATED);
  EXPECT_EQ(readings[80].status[2], hall_array_t::STATUS_STALE);
  EXPECT_EQ(readings[80].status[3], hall_array_t::STATUS_OK);
  EXPECT_EQ(readings[80].field[3], readings[49].field[3]);
  EXPECT_NE(readings[80].field[0], readings[49].field[0]);
}

TEST_F(VirtualRigProcessTest, AbsentCapsuleLeavesOnlyTheMagneticChannels) {
  VirtualRigScenario scenario = small_scenario();
  scenario.trajectory.kind = TrajectoryKind::kAbsent;
  std::map<std::string, int> counts = count(play(scenario));
  EXPECT_EQ(counts[channel::kHallArray], 100);
  EXPECT_EQ(counts.count(channel::kCamera), 0U);
  EXPECT_EQ(counts.count(channel::kGroundTruthPose), 0U);
}

TEST_F(VirtualRigProcessTest, SkippedPicturesAreCounted) {
  const VirtualRigScenario scenario = small_scenario();
  int published = 0;
  VirtualRigProcess rig(scenario, kStart,
                        [&](const std::string& name, std::vector<std::uint8_t>, std::int64_t) {
                          published += name == channel::kCamera;
                        });
  rig.skip_pictures([](double time) { return time > 0.5; });
  while (rig.next_time() < scenario.duration) rig.step();
  EXPECT_EQ(published, rig.pictures());
  EXPECT_EQ(rig.pictures() + rig.pictures_skipped(), 20);
  EXPECT_EQ(rig.pictures(), 11);
}

}  // namespace
}  // namespace gastronaut

#include "sensor_fusion/sensor_fusion_process.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <vector>

#include "bus/memory_bus.hpp"
#include "gastronaut/capsule_state_t.hpp"
#include "gastronaut/pose_t.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr std::int64_t kPeriod = 10'000;  // microseconds

class SensorFusionProcessTest : public ::testing::Test {
 protected:
  SensorFusionProcessTest() : bus_(&network_.connect()), process_(*bus_, rig_) {}

  template <class Message>
  void inject(const char* channel, const Message& message) {
    network_.inject(channel, encode_message(message));
    network_.run_until_idle();
  }
  void end() {
    network_.finish([this](std::size_t) { process_.finish(); });
  }

  static magnetic_pose_t fix(int number) {
    magnetic_pose_t message{};
    message.utime = number * kPeriod;
    message.seq = number;
    message.status = magnetic_pose_t::STATUS_OK;
    message.position[2] = 0.06;
    message.axis[2] = 1;
    for (int i = 0; i < 5; ++i) message.covariance[i][i] = i < 3 ? 1e-7 : 2.5e-5;
    return message;
  }
  static visual_pose_t frame(int number) {
    visual_pose_t message{};
    message.utime = number * kPeriod;
    message.status = visual_pose_t::STATUS_OK;
    message.orientation[0] = 1;
    for (int i = 0; i < 6; ++i) message.covariance[i][i] = 1e-7;
    return message;
  }
  std::vector<std::int64_t> utimes() const {
    std::vector<std::int64_t> result;
    for (const capsule_state_t& state : states_) result.push_back(state.utime / kPeriod);
    return result;
  }

  RigConfiguration rig_;
  std::vector<capsule_state_t> states_;
  std::vector<pose_t> poses_;
  MemoryNetwork network_{[this](const std::string& channel, Bytes payload, std::int64_t) {
    if (channel == channel::kCapsuleState) {
      ASSERT_EQ(decode_message(payload, states_.emplace_back()), DecodeResult::kOk);
    } else if (channel == channel::kCapsulePose) {
      ASSERT_EQ(decode_message(payload, poses_.emplace_back()), DecodeResult::kOk);
    }
  }};
  Bus* bus_;
  SensorFusionProcess process_;
};

TEST_F(SensorFusionProcessTest, OneStateAndOnePoseAUtime) {
  for (int i = 1; i <= 10; ++i) {
    inject(channel::kMagneticPose, fix(i));
    if (i % 5 == 0) inject(channel::kVisualPose, frame(i));
  }
  end();
  EXPECT_THAT(utimes(), ElementsAre(1, 2, 3, 4, 5, 6, 7, 8, 9, 10));
  ASSERT_EQ(poses_.size(), states_.size());
  for (std::size_t i = 0; i < states_.size(); ++i) {
    EXPECT_EQ(poses_[i].utime, states_[i].utime);
    for (int k = 0; k < 3; ++k) EXPECT_EQ(poses_[i].pos[k], states_[i].position[k]);
    for (int k = 0; k < 4; ++k) EXPECT_EQ(poses_[i].orientation[k], states_[i].orientation[k]);
    ASSERT_EQ(states_[i].num_sensors, 2);
    EXPECT_EQ(states_[i].sensors[0].name, "magnetic");
    EXPECT_EQ(states_[i].sensors[1].name, "visual");
    EXPECT_EQ(states_[i].status, static_cast<int>(capsule_state_t::STATUS_INITIALISING));
  }
}

TEST_F(SensorFusionProcessTest, TheStateOfBothSensorsHasVisionInIt) {
  // The order of arrival does not matter.
  inject(channel::kMagneticPose, fix(1));
  inject(channel::kVisualPose, frame(1));
  visual_pose_t lost = frame(2);
  lost.status = visual_pose_t::STATUS_LOST;
  inject(channel::kVisualPose, lost);
  inject(channel::kMagneticPose, fix(2));
  end();
  EXPECT_THAT(utimes(), ElementsAre(1, 2));
  EXPECT_FALSE(states_[1].sensors[1].used);
}

TEST_F(SensorFusionProcessTest, FailuresAreNamedInStateAndHealth) {
  constexpr int kSteps = 100;
  for (int i = 1; i <= kSteps; ++i) {
    magnetic_pose_t disturbed = fix(i);
    visual_pose_t lost = frame(i);
    if (i > kSteps / 2) {
      disturbed.status = magnetic_pose_t::STATUS_INTERFERENCE;
      lost.status = visual_pose_t::STATUS_LOST;
    }
    inject(channel::kMagneticPose, disturbed);
    inject(channel::kVisualPose, lost);
  }
  end();
  const capsule_state_t& state = states_.back();
  EXPECT_EQ(state.status, static_cast<int>(capsule_state_t::STATUS_PREDICTING));
  EXPECT_EQ(state.sensors[0].cause, "interference");
  EXPECT_EQ(state.sensors[1].cause, "lost");
  EXPECT_EQ(bus_->state(), ProcessState::kDegraded);
  EXPECT_THAT(bus_->describe_health(), HasSubstr("the magnetic sensor has failed: interference"));
  EXPECT_THAT(bus_->describe_health(), HasSubstr("the visual sensor has failed: lost"));
}

TEST_F(SensorFusionProcessTest, WithoutMotionItAsksForSome) {
  for (int i = 1; i <= 20; ++i) {
    inject(channel::kMagneticPose, fix(i));
    inject(channel::kVisualPose, frame(i));
  }
  end();
  EXPECT_EQ(bus_->state(), ProcessState::kDegraded);
  EXPECT_THAT(bus_->describe_health(), HasSubstr("move and turn the capsule"));
}

TEST_F(SensorFusionProcessTest, NotANumberNeverComesOut) {
  constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  for (int i = 1; i <= 30; ++i) {
    magnetic_pose_t bad_fix = fix(i);
    visual_pose_t bad_frame = frame(i);
    if (i % 3 == 0) bad_fix.position[i % 2] = bad_fix.covariance[2][1] = kNaN;
    if (i % 4 == 0) bad_frame.orientation[1] = bad_frame.covariance[0][0] = kNaN;
    inject(channel::kMagneticPose, bad_fix);
    inject(channel::kVisualPose, bad_frame);
  }
  end();
  ASSERT_FALSE(states_.empty());
  for (const capsule_state_t& state : states_) {
    for (const double value : state.position) EXPECT_TRUE(std::isfinite(value));
    for (const double value : state.orientation) EXPECT_TRUE(std::isfinite(value));
    for (const auto& row : state.covariance) {
      for (const double value : row) EXPECT_TRUE(std::isfinite(value));
    }
    EXPECT_TRUE(std::isfinite(state.depth_scale));
  }
}

TEST_F(SensorFusionProcessTest, LateAndRepeatedMessagesKeepUtimesAscending) {
  for (const int number : {1, 2, 2, 5, 6, 3, 7, 7, 8}) {
    inject(channel::kMagneticPose, fix(number));
    inject(channel::kVisualPose, frame(number));
  }
  end();
  for (std::size_t i = 1; i < states_.size(); ++i) {
    EXPECT_GE(states_[i].utime, states_[i - 1].utime);
  }
  EXPECT_EQ(states_.back().utime, 8 * kPeriod);
}

}  // namespace
}  // namespace gastronaut

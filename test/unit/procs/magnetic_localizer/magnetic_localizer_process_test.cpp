#include "magnetic_localizer/magnetic_localizer_process.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>
#include <memory>
#include <vector>

#include "bus/memory_bus.hpp"
#include "gastronaut/magnetic_pose_t.hpp"
#include "process/channels.hpp"
#include "unit/procs/magnetic_localizer/simulated_array.hpp"

namespace gastronaut {
namespace {

using magnetics::FixStatus;
using magnetics::HallReading;
using magnetics::MagnetState;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr std::int64_t kPeriod = 10'000;  // microseconds, 100 Hz

FixStatus status_of(const magnetic_pose_t& pose) { return static_cast<FixStatus>(pose.status); }

class MagneticLocalizerProcessTest : public ::testing::Test {
 protected:
  MagneticLocalizerProcessTest() {
    truth_.position = {0.01, -0.02, 0.03};
    truth_.axis = Eigen::Vector3d(0.5, 0.3, -0.8).normalized();
    truth_.moment = rig_.magnet.moment;
  }

  void add_coils() {
    rig_.coils.tesla_per_ampere = Eigen::MatrixXd::Constant(3 * 64, 2, 1e-4);
    rig_.coils.tesla_per_ampere.topRows(90).col(1) *= -1;
  }

  void start() {
    bus_ = &network_.connect();
    process_ = std::make_unique<MagneticLocalizerProcess>(*bus_, rig_);
  }

  template <class Message>
  void inject(const char* channel, const Message& message) {
    network_.inject(channel, encode_message(message));
    network_.run_until_idle();
  }

  hall_array_t hall(int seq, const Eigen::Vector2d& currents = Eigen::Vector2d::Zero()) {
    HallReading reading = test::simulate_reading(rig_.hall_array, rig_.magnet, truth_, nullptr);
    if (rig_.coils.tesla_per_ampere.size() > 0) {
      reading.field += rig_.coils.tesla_per_ampere * currents;
    }
    hall_array_t message;
    message.utime = seq * kPeriod;
    message.seq = seq;
    message.num_sensors = 64;
    message.num_axes = 3;
    message.field.assign(64, std::vector<float>(3));
    message.status.assign(64, 0);
    for (std::size_t s = 0; s < 64; ++s) {
      for (std::size_t axis = 0; axis < 3; ++axis) {
        message.field[s][axis] =
            static_cast<float>(reading.field[static_cast<Eigen::Index>(3 * s + axis)]);
      }
    }
    return message;
  }

  static coil_currents_t currents(std::int64_t utime, const Eigen::Vector2d& amperes) {
    coil_currents_t message;
    message.utime = utime;
    message.seq = static_cast<std::int32_t>(utime / kPeriod);
    message.num_coils = 2;
    message.current = {static_cast<float>(amperes[0]), static_cast<float>(amperes[1])};
    return message;
  }

  void end() {
    network_.finish([this](std::size_t) { process_->finish(); });
  }

  std::vector<int> sequence_numbers() const {
    std::vector<int> numbers;
    for (const magnetic_pose_t& pose : poses_) numbers.push_back(pose.seq);
    return numbers;
  }

  void expect_truth(const magnetic_pose_t& pose) const {
    // Readings travel as 32-bit floats: parts in 1e7 of the field, far below the sensors' noise.
    constexpr double kRounding = 1e-5;  // metres
    EXPECT_EQ(status_of(pose), FixStatus::kOk);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(pose.position[k], truth_.position[k], kRounding);
  }

  RigConfiguration rig_ = test::exact_rig();
  MagnetState truth_;
  std::vector<magnetic_pose_t> poses_;
  MemoryNetwork network_{[this](const std::string& channel, Bytes payload, std::int64_t) {
    if (channel != channel::kMagneticPose) return;
    magnetic_pose_t pose;
    ASSERT_EQ(decode_message(payload, pose), DecodeResult::kOk);
    poses_.push_back(pose);
  }};
  Bus* bus_ = nullptr;
  std::unique_ptr<MagneticLocalizerProcess> process_;
};

TEST_F(MagneticLocalizerProcessTest, EveryReadingGivesOnePoseOfItsOwnTime) {
  start();
  for (int seq = 1; seq <= 4; ++seq) inject(channel::kHallArray, hall(seq));
  end();
  EXPECT_THAT(sequence_numbers(), ElementsAre(1, 2, 3, 4));
  for (const magnetic_pose_t& pose : poses_) {
    EXPECT_EQ(pose.utime, pose.seq * kPeriod);
    expect_truth(pose);
    EXPECT_GT(pose.covariance[0][0], 0);
    EXPECT_EQ(pose.num_channels_used, 192);
  }
}

TEST_F(MagneticLocalizerProcessTest, ReadingWaitsForTheCurrentsAroundItAndUsesThemInterpolated) {
  add_coils();
  start();
  const Eigen::Vector2d before(1, -2);
  const Eigen::Vector2d after(3, 2);
  inject(channel::kCoilCurrents, currents(kPeriod, before));
  truth_.background = {1e-5, 0, 0};
  hall_array_t between = hall(1, (before + after) / 2);
  between.utime = kPeriod + kPeriod / 2;
  inject(channel::kHallArray, between);
  EXPECT_TRUE(poses_.empty());
  inject(channel::kCoilCurrents, currents(2 * kPeriod, after));
  end();
  ASSERT_EQ(poses_.size(), 1U);
  expect_truth(poses_[0]);
}

TEST_F(MagneticLocalizerProcessTest, CurrentsOfTheSameTimeComeFirst) {
  add_coils();
  start();
  const Eigen::Vector2d amperes(2, 1);
  inject(channel::kHallArray, hall(1, amperes));
  inject(channel::kCoilCurrents, currents(kPeriod, amperes));
  ASSERT_EQ(poses_.size(), 1U);
  expect_truth(poses_[0]);
}

TEST_F(MagneticLocalizerProcessTest, SilentCoilDriverGivesPosesThatSayNoCurrents) {
  add_coils();
  start();
  constexpr int kReadings = 100;  // one second: beyond lag and gap
  for (int seq = 1; seq <= kReadings; ++seq) {
    inject(channel::kHallArray, hall(seq, Eigen::Vector2d(2, 1)));
  }
  EXPECT_GT(poses_.size(), 0U);
  EXPECT_THAT(bus_->describe_health(), HasSubstr("COIL_CURRENTS"));
  end();
  ASSERT_EQ(poses_.size(), static_cast<std::size_t>(kReadings));
  for (const magnetic_pose_t& pose : poses_) {
    EXPECT_EQ(status_of(pose), FixStatus::kNoCurrents);
  }
}

TEST_F(MagneticLocalizerProcessTest, CurrentsAreHeldAcrossAShortGapAtTheEnd) {
  add_coils();
  start();
  const Eigen::Vector2d amperes(2, 1);
  inject(channel::kCoilCurrents, currents(kPeriod, amperes));
  inject(channel::kHallArray, hall(3, amperes));
  EXPECT_TRUE(poses_.empty());
  end();
  ASSERT_EQ(poses_.size(), 1U);
  expect_truth(poses_[0]);
}

TEST_F(MagneticLocalizerProcessTest, ReadingOfAnotherRigIsRefusedInWordsAndStillAnswered) {
  start();
  hall_array_t foreign = hall(1);
  foreign.num_sensors = 2;
  foreign.field.resize(2);
  foreign.status.resize(2);
  inject(channel::kHallArray, foreign);
  EXPECT_EQ(bus_->state(), ProcessState::kDegraded);
  EXPECT_THAT(bus_->describe_health(), HasSubstr("HALL_ARRAY has 2 sensors"));
  inject(channel::kHallArray, hall(2));
  EXPECT_EQ(bus_->state(), ProcessState::kRunning);
  end();
  ASSERT_EQ(poses_.size(), 2U);
  EXPECT_EQ(status_of(poses_[0]), FixStatus::kNoFix);
  EXPECT_GT(poses_[0].covariance[0][0], 0.01);  // metres^2: anywhere in the box
  expect_truth(poses_[1]);
}

TEST_F(MagneticLocalizerProcessTest, UndefinedReadingsDoNoHarm) {
  start();
  hall_array_t undefined = hall(1);
  for (auto& sensor : undefined.field) {
    sensor.assign(3, std::numeric_limits<float>::quiet_NaN());
  }
  inject(channel::kHallArray, undefined);
  inject(channel::kHallArray, hall(2));
  end();
  ASSERT_EQ(poses_.size(), 2U);
  EXPECT_EQ(status_of(poses_[0]), FixStatus::kSaturated);
  expect_truth(poses_[1]);
}

TEST_F(MagneticLocalizerProcessTest, UndefinedCurrentsAreBridgedLikeMissingOnes) {
  add_coils();
  start();
  const Eigen::Vector2d amperes(2, 1);
  inject(channel::kCoilCurrents, currents(kPeriod, amperes));
  inject(channel::kCoilCurrents,
         currents(2 * kPeriod, {std::numeric_limits<double>::quiet_NaN(), 1}));
  inject(channel::kCoilCurrents, currents(3 * kPeriod, amperes));
  inject(channel::kHallArray, hall(2, amperes));
  end();
  ASSERT_EQ(poses_.size(), 1U);
  expect_truth(poses_[0]);
}

TEST_F(MagneticLocalizerProcessTest, SecondDifferencesOnScatteredSensorsAreRefused) {
  rig_.magnetic_localizer.estimator = MagneticEstimator::kSecondDifference;
  rig_.hall_array.sensors = rig_.hall_array.resolved_sensors();
  rig_.hall_array.sensors[5].position.x() += 0.003;
  EXPECT_THROW(start(), ConfigurationError);
}

}  // namespace
}  // namespace gastronaut

#include "uvc_camera/uvc_camera_process.hpp"

#include <gmock/gmock.h>

#include <gastronaut/image_t.hpp>
#include <gastronaut/rig_config_t.hpp>
#include <map>

#include "bus/memory_bus.hpp"
#include "bus/wire.hpp"
#include "process/channels.hpp"
#include "unit/drivers/uvc_camera/test_pictures.hpp"

namespace gastronaut {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Pair;
constexpr std::int64_t kStart = 1'700'000'000'000'000;  // utime

class Publishing : public ::testing::Test {
 protected:
  Publishing()
      : network_([this](const std::string& channel, Bytes payload, std::int64_t) {
          if (channel == channel::kCamera) {
            ASSERT_EQ(decode_message(payload, images_.emplace_back()), DecodeResult::kOk);
          } else if (channel == channel::kRigConfig) {
            ++configurations_;
          }
        }) {}
  static Picture picture(std::int64_t utime) {
    return {PictureEncoding::kMjpeg, 320, 240, utime, jpeg_picture(320, 240, 0)};
  }
  static std::map<std::string, std::string> metadata(const image_t& image) {
    std::map<std::string, std::string> entries;
    for (const auto& entry : image.metadata) {
      entries[entry.key] = std::string(entry.value.begin(), entry.value.end());
    }
    return entries;
  }

  std::vector<image_t> images_;
  int configurations_ = 0;
  MemoryNetwork network_;
  RigConfiguration rig_;
};

TEST_F(Publishing, JpegGoesOutUntouchedWithWhatDepthNeeds) {
  rig_.uvc_camera.calibrated_exposure = 4e-3;
  UvcCameraProcess process(network_.connect(), rig_);
  LockedControls controls;
  controls.exposure = 6e-3;
  controls.gain = 20;
  process.handle(picture(kStart), controls);
  process.handle(picture(kStart + 50'000), controls);
  ASSERT_EQ(images_.size(), 2u);
  const image_t& image = images_[1];
  EXPECT_EQ(image.utime, kStart + 50'000);
  EXPECT_EQ(image.width, 320);
  EXPECT_EQ(image.height, 240);
  EXPECT_EQ(image.pixelformat, image_t::PIXEL_FORMAT_MJPEG);
  EXPECT_EQ(image.data, jpeg_picture(320, 240, 0));
  EXPECT_THAT(metadata(image), ElementsAre(Pair("exposure_us", "6000"), Pair("gain", "1.5"),
                                           Pair("sensor_gain", "20"), Pair("seq", "1")));
  EXPECT_EQ(configurations_, 1);
}

TEST_F(Publishing, WhatTheCameraDoesNotTellIsNotMadeUp) {
  UvcCameraProcess process(network_.connect(), rig_);
  process.handle(picture(kStart), {});
  ASSERT_EQ(images_.size(), 1u);
  EXPECT_THAT(metadata(images_[0]), ElementsAre(Pair("seq", "0")));
}

TEST_F(Publishing, UncompressedPicturesAreEncoded) {
  UvcCameraProcess process(network_.connect(), rig_);
  process.handle({PictureEncoding::kYuyv, 320, 240, kStart, yuyv_picture(320, 240, 1)}, {});
  ASSERT_EQ(images_.size(), 1u);
  EXPECT_EQ(images_[0].pixelformat, image_t::PIXEL_FORMAT_MJPEG);
  EXPECT_EQ(picture_problem(PictureEncoding::kMjpeg, 320, 240, images_[0].data), "");
}

TEST_F(Publishing, TimesAlwaysGrowUnlessTheClockWasSetBack) {
  UvcCameraProcess process(network_.connect(), rig_);
  constexpr std::int64_t kHour = 3'600'000'000;
  for (const std::int64_t utime : {kStart, kStart, kStart - 10, kStart - kHour}) {
    process.handle(picture(utime), {});
  }
  std::vector<std::int64_t> times;
  for (const image_t& image : images_) times.push_back(image.utime - kStart);
  EXPECT_THAT(times, ElementsAre(0, 1, 2, -kHour));
}

TEST_F(Publishing, HealthTellsWhatIsNew) {
  UvcCameraProcess process(network_.connect(), rig_);
  EXPECT_THAT(process.report({0, 0, 0}, {}).message, HasSubstr("no picture comes"));
  EXPECT_EQ(process.report({10, 0, 0}, {}).state, ProcessState::kRunning);
  EXPECT_THAT(process.report({20, 3, 1}, {}).message,
              AllOf(HasSubstr("3 pictures were damaged"), HasSubstr("1 pictures were lost")));
  EXPECT_EQ(process.report({30, 3, 1}, {}).state, ProcessState::kRunning);
  LockedControls controls;
  controls.problems = {"gain is 3"};
  EXPECT_EQ(process.report({40, 3, 1}, controls).state, ProcessState::kDegraded);
}

}  // namespace
}  // namespace gastronaut

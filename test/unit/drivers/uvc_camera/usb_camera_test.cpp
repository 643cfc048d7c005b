// The driver against a played camera, over a transport without a bus.
#include "uvc_camera/usb_camera.hpp"

#include <gmock/gmock.h>

#include <deque>

#include "unit/drivers/uvc_camera/played_camera.hpp"
#include "unit/drivers/uvc_camera/test_pictures.hpp"

namespace gastronaut {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
constexpr std::int64_t kStart = 1'700'000'000'000'000;  // utime
constexpr std::int64_t kPeriod = 100'000;               // microseconds

// What lies between camera and driver, and outlives the driver's end of it.
struct Cable {
  explicit Cable(bool is_isochronous) : camera(is_isochronous) {}
  PlayedCamera camera;
  std::deque<Octets> under_way;
  bool is_plugged = true;
  bool is_stopped = false;
};

class CableEnd : public UsbTransport {
 public:
  explicit CableEnd(Cable& cable) : cable_(cable) {}
  bool get(std::uint8_t request, std::uint16_t value, std::uint16_t index,
           std::span<std::uint8_t> data) override {
    check();
    const auto answer = cable_.camera.answer(
        {0xa1, request, value, index, static_cast<std::uint16_t>(data.size())}, {});
    if (!answer) return false;
    std::copy_n(answer->begin(), std::min(answer->size(), data.size()), data.begin());
    return true;
  }
  bool set(std::uint8_t request, std::uint16_t value, std::uint16_t index,
           std::span<const std::uint8_t> data) override {
    check();
    return cable_.camera
        .answer({0x21, request, value, index, static_cast<std::uint16_t>(data.size())}, data)
        .has_value();
  }
  void select_alternate(int interface, int setting) override {
    check();
    cable_.camera.answer(
        {0x01, 11, static_cast<std::uint16_t>(setting), static_cast<std::uint16_t>(interface), 0},
        {});
  }
  void start_isochronous(std::uint8_t endpoint, int bytes, Sink sink) override {
    EXPECT_EQ(endpoint, PlayedCamera::kEndpoint);
    EXPECT_GE(bytes, cable_.camera.payload_bytes());
    sink_ = std::move(sink);
  }
  void start_bulk(std::uint8_t endpoint, int bytes, Sink sink) override {
    EXPECT_EQ(endpoint, PlayedCamera::kEndpoint);
    bytes_ = static_cast<std::size_t>(bytes);
    sink_ = std::move(sink);
  }
  void serve(double) override {
    check();
    for (; !cable_.under_way.empty(); cable_.under_way.pop_front()) {
      const Octets& payload = cable_.under_way.front();
      if (payload.empty()) {
        sink_({{}, false, true});
      } else {
        sink_({payload, payload.size() < bytes_, false});
      }
    }
  }
  void stop() override { cable_.is_stopped = true; }

 private:
  void check() const {
    if (!cable_.is_plugged) throw CameraUnavailable("unplugged");
  }
  Cable& cable_;
  Sink sink_;
  std::size_t bytes_ = 0;
};

class PlayedUsbCamera : public ::testing::TestWithParam<bool> {
 protected:
  PlayedUsbCamera() : cable_(GetParam()) {
    rig_.camera.width = 320;
    rig_.camera.height = 240;
    rig_.camera.rate = 10;
    rig_.uvc_camera.exposure = 5e-3;
    rig_.uvc_camera.gain = 20;
    rig_.uvc_camera.white_balance = 4500;
  }
  std::unique_ptr<UsbCamera> open() {
    auto functions = parse_uvc_descriptors(cable_.camera.configuration_descriptor());
    return std::make_unique<UsbCamera>(std::make_unique<CableEnd>(cable_),
                                       std::move(functions.at(0)), rig_, "played",
                                       [this] { return utime_; });
  }
  void send(const Octets& picture, int number, const PlayedCamera::Faults& faults = {}) {
    const auto begin = static_cast<std::uint32_t>(number * kPeriod);
    constexpr std::uint32_t kReadout = 30'000;
    utime_ = kStart + number * kPeriod + kReadout;
    for (Octets& payload : cable_.camera.payloads(picture, begin, begin + kReadout, faults)) {
      cable_.under_way.push_back(std::move(payload));
    }
  }

  Cable cable_;
  RigConfiguration rig_;
  std::int64_t utime_ = kStart;
};

TEST_P(PlayedUsbCamera, PicturesComeAsTheyWereSentWithTheMiddleOfTheirExposure) {
  const auto camera = open();
  EXPECT_TRUE(cable_.camera.is_streaming());
  EXPECT_DOUBLE_EQ(cable_.camera.interval(), 0.1);
  for (int i = 0; i < 10; ++i) {
    const Octets sent = jpeg_picture(320, 240, i);
    send(sent, i);
    const std::optional<Picture> picture = camera->next(0);
    ASSERT_TRUE(picture);
    EXPECT_EQ(picture->data, sent);
    EXPECT_EQ(picture->utime, kStart + i * kPeriod + 2500);
    EXPECT_FALSE(camera->next(0));
  }
  EXPECT_EQ(camera->counters().pictures, 10);
  EXPECT_EQ(camera->counters().damaged, 0);
  EXPECT_THAT(camera->describe(), HasSubstr("MJPEG 320x240 at 10 Hz"));
}

TEST_P(PlayedUsbCamera, UncompressedPicturesComeWhole) {
  rig_.uvc_camera.format = "yuyv";
  rig_.camera.width = 160;
  rig_.camera.height = 120;
  const auto camera = open();
  EXPECT_FALSE(cable_.camera.is_mjpeg());
  send(yuyv_picture(160, 120, 1), 0);
  const std::optional<Picture> picture = camera->next(0);
  ASSERT_TRUE(picture);
  EXPECT_EQ(picture->encoding, PictureEncoding::kYuyv);
  EXPECT_EQ(picture->data, yuyv_picture(160, 120, 1));
}

TEST_P(PlayedUsbCamera, ControlsAreLockedAndReadBack) {
  const auto camera = open();
  EXPECT_DOUBLE_EQ(camera->controls().exposure.value(), 5e-3);
  EXPECT_EQ(camera->controls().gain, 20);
  EXPECT_EQ(camera->controls().white_balance, 4500);
  EXPECT_THAT(camera->controls().problems, IsEmpty());
  EXPECT_EQ(cable_.camera.control(1, 2), 1);  // manual
  EXPECT_EQ(cable_.camera.control(1, 3), 0);  // the rate stays
  EXPECT_EQ(cable_.camera.control(1, 4), 50);
  EXPECT_EQ(cable_.camera.control(2, 0x0b), 0);
}

TEST_P(PlayedUsbCamera, WhatIsNotAskedForStaysAndIsTold) {
  rig_.uvc_camera = {};
  const auto camera = open();
  EXPECT_DOUBLE_EQ(camera->controls().exposure.value(), 16.6e-3);
  EXPECT_EQ(camera->controls().gain, 16);
  EXPECT_EQ(cable_.camera.control(1, 2), 1);  // and is manual all the same
}

TEST_P(PlayedUsbCamera, AValueOutOfTheCamerasRangeIsAProblemThatNamesTheRange) {
  rig_.uvc_camera.gain = 300;
  const auto camera = open();
  EXPECT_EQ(camera->controls().gain, 255);
  EXPECT_THAT(camera->controls().problems, ElementsAre(HasSubstr("0 to 255")));
}

TEST_P(PlayedUsbCamera, DamagedPicturesAreCountedAndLeftOut) {
  const auto camera = open();
  int number = 0;
  send(jpeg_picture(320, 240, 0), number++);
  send(jpeg_picture(320, 240, 1), number++, {.has_error = true});
  send(jpeg_picture(320, 240, 2), number++, {.kept_share = 0.6});
  send(jpeg_picture(320, 240, 3), number++);
  cable_.under_way.insert(cable_.under_way.end() - 1, Octets{});  // lost on the bus
  send(jpeg_picture(160, 120, 4), number++);
  send(jpeg_picture(320, 240, 5), number++);
  std::vector<Octets> came;
  while (auto picture = camera->next(0)) came.push_back(picture->data);
  EXPECT_THAT(came, ElementsAre(jpeg_picture(320, 240, 0), jpeg_picture(320, 240, 5)));
  EXPECT_EQ(camera->counters().damaged, 4);
}

TEST_P(PlayedUsbCamera, UnpluggingEndsItAndStoppingDoesNotHang) {
  auto camera = open();
  cable_.is_plugged = false;
  EXPECT_THROW(camera->next(0), CameraUnavailable);
  camera.reset();
  EXPECT_TRUE(cable_.is_stopped);
}

TEST_P(PlayedUsbCamera, ItIsToldToStop) {
  auto camera = open();
  camera.reset();
  EXPECT_TRUE(cable_.is_stopped);
  EXPECT_EQ(cable_.camera.is_streaming(), !GetParam());  // bulk: nothing is asked for any more
}

TEST_P(PlayedUsbCamera, ASizeThatItHasNotIsRefusedWithThoseThatItHas) {
  rig_.camera.width = 333;
  try {
    open();
    FAIL();
  } catch (const ConfigurationError& problem) {
    EXPECT_THAT(problem.what(), HasSubstr("MJPEG 320x240 640x480 160x120; YUY2 320x240"));
  }
}

INSTANTIATE_TEST_SUITE_P(Transfers, PlayedUsbCamera, ::testing::Bool(), [](const auto& instance) {
  return instance.param ? "Isochronous" : "Bulk";
});

}  // namespace
}  // namespace gastronaut

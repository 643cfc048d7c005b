#include "uvc_camera/uvc_frame_assembler.hpp"

#include <gmock/gmock.h>

#include "unit/drivers/uvc_camera/played_camera.hpp"

namespace gastronaut {
namespace {

constexpr std::int64_t kStart = 1'700'000'000'000'000;  // utime
constexpr std::int64_t kPeriod = 33'333;                // microseconds
constexpr std::size_t kLargest = 100'000;

class Assembling : public ::testing::TestWithParam<bool> {
 protected:
  Assembling()
      : camera_(GetParam()),
        assembler_({kLargest, PlayedCamera::kBulkPayload, PlayedCamera::kClockFrequency},
                   [this](UvcFrame frame) { frames_.push_back(std::move(frame)); }) {}

  static Octets picture(int number, std::size_t size = 40'000) {
    Octets data;
    for (std::size_t i = 0; i < size; ++i) {
      data.push_back(static_cast<std::uint8_t>(i * 7 + i / 251 + static_cast<std::size_t>(number)));
    }
    return data;
  }

  // Sends a picture that was begun `number` periods after the start and arrives `delay` later.
  void send(int number, const Octets& data, const PlayedCamera::Faults& faults = {},
            std::int64_t delay = kDelay) {
    const std::int64_t begin = number * kPeriod;
    const std::int64_t sent = begin + kExposureAndReadout;
    // The camera's clock is 32 bits and began somewhere; it goes around during the tests.
    const auto clock = [](std::int64_t time) {
      return static_cast<std::uint32_t>(0xffff0000u + static_cast<std::uint64_t>(time));
    };
    for (const Octets& payload : camera_.payloads(data, clock(begin), clock(sent), faults)) {
      deliver(payload, kStart + sent + delay);
    }
  }
  void deliver(const Octets& payload, std::int64_t utime) {
    if (GetParam()) return assembler_.add_payload(payload, utime);
    // In transfers of four packets: a payload may come in several.
    constexpr std::size_t kTransfer = 2048;
    const std::span<const std::uint8_t> bytes(payload);
    for (std::size_t at = 0; at < bytes.size(); at += kTransfer) {
      const auto part = bytes.subspan(at, std::min(kTransfer, bytes.size() - at));
      assembler_.add_bulk_transfer(part, part.size() < kTransfer, utime);
    }
    // A payload that ends with a whole transfer and is shorter than the longest ends with an empty
    // one.
    if (bytes.size() % kTransfer == 0 && bytes.size() < PlayedCamera::kBulkPayload) {
      assembler_.add_bulk_transfer({}, true, utime);
    }
  }

  static constexpr std::int64_t kExposureAndReadout = 12'000;  // microseconds
  static constexpr std::int64_t kDelay = 400;
  PlayedCamera camera_;
  std::vector<UvcFrame> frames_;
  UvcFrameAssembler assembler_;
};

TEST_P(Assembling, FramesAreWhatWasSent) {
  for (int i = 0; i < 20; ++i) {
    send(i, picture(i, 30'000 + 977 * static_cast<std::size_t>(i)));
  }
  ASSERT_EQ(frames_.size(), 20u);
  for (int i = 0; i < 20; ++i) {
    const UvcFrame& frame = frames_[static_cast<std::size_t>(i)];
    EXPECT_EQ(frame.data, picture(i, 30'000 + 977 * static_cast<std::size_t>(i)));
    EXPECT_TRUE(frame.is_ended);
  }
  EXPECT_EQ(assembler_.counters().frames, 20);
  EXPECT_EQ(assembler_.counters().damaged, 0);
}

TEST_P(Assembling, CaptureIsTheCamerasTimeInTheHostsClockWhateverTheDelay) {
  for (int i = 0; i < 300; ++i) {
    // Every third comes 20 ms late: the host was busy.
    send(i, picture(i, 5000), {}, i % 3 == 2 ? 20'000 : kDelay);
  }
  ASSERT_EQ(frames_.size(), 300u);
  // The offset is the least delay; it may creep by the drift that clocks are allowed in three
  // frames.
  constexpr std::int64_t kTolerance = 20;
  for (int i = 0; i < 300; ++i) {
    ASSERT_TRUE(frames_[static_cast<std::size_t>(i)].capture);
    EXPECT_NEAR(static_cast<double>(*frames_[static_cast<std::size_t>(i)].capture),
                static_cast<double>(kStart + i * kPeriod + kDelay), kTolerance);
  }
}

TEST_P(Assembling, AMissingEndMarkIsMadeUpByTheNextFrame) {
  send(0, picture(0), {.is_end_missing = true});
  EXPECT_TRUE(frames_.empty());
  send(1, picture(1));
  ASSERT_EQ(frames_.size(), 2u);
  EXPECT_EQ(frames_[0].data, picture(0));
  EXPECT_FALSE(frames_[0].is_ended);
  EXPECT_EQ(frames_[1].data, picture(1));
}

TEST_P(Assembling, FramesWithAnErrorMarkOrALossAreCountedAndLeftOut) {
  send(0, picture(0));
  send(1, picture(1), {.has_error = true});
  const auto payloads = camera_.payloads(picture(2), 0, 0, {});
  deliver(payloads[0], kStart);
  assembler_.add_loss();
  for (std::size_t i = 1; i < payloads.size(); ++i) deliver(payloads[i], kStart);
  send(3, picture(3));
  ASSERT_EQ(frames_.size(), 2u);
  EXPECT_EQ(frames_[1].data, picture(3));
  EXPECT_EQ(assembler_.counters().damaged, 2);
}

TEST_P(Assembling, FramesLargerThanAnnouncedAreCountedAndLeftOut) {
  send(0, picture(0, kLargest + 1));
  send(1, picture(1, kLargest));
  ASSERT_EQ(frames_.size(), 1u);
  EXPECT_EQ(frames_[0].data.size(), kLargest);
  EXPECT_EQ(assembler_.counters().oversized, 1);
}

TEST_P(Assembling, PayloadsWithoutAHeaderDamageTheirFrame) {
  const auto payloads = camera_.payloads(picture(0), 0, 0, {});
  deliver(payloads[0], kStart);
  for (const Octets& bad : {Octets{200, 0x8c, 1}, Octets{1}, Octets{4, 0x8c, 0, 0}}) {
    deliver(bad, kStart);
  }
  for (std::size_t i = 1; i < payloads.size(); ++i) deliver(payloads[i], kStart);
  EXPECT_TRUE(frames_.empty());
  EXPECT_EQ(assembler_.counters().malformed, 3);
  EXPECT_EQ(assembler_.counters().damaged, 1);
  send(1, picture(1));
  EXPECT_EQ(frames_.size(), 1u);
}

TEST_P(Assembling, HeadersWithoutPictureAreNoFrames) {
  for (int i = 0; i < 100; ++i) deliver({2, 0x80}, kStart + i);
  deliver({2, 0x82}, kStart + 100);
  EXPECT_TRUE(frames_.empty());
}

INSTANTIATE_TEST_SUITE_P(Transfers, Assembling, ::testing::Bool(), [](const auto& instance) {
  return instance.param ? "Isochronous" : "Bulk";
});

}  // namespace
}  // namespace gastronaut

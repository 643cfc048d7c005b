#include "depth_estimator/picture_decoder.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <vector>

#include "unit/procs/depth_estimator/jpeg_encoder.hpp"

namespace gastronaut::perception {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr int kWidth = 48;
constexpr int kHeight = 32;
constexpr int kJpegError = 3;  // levels, of a smooth picture at quality 95

std::vector<std::uint8_t> gradient() {
  std::vector<std::uint8_t> rgb;
  for (int v = 0; v < kHeight; ++v) {
    for (int u = 0; u < kWidth; ++u) {
      rgb.push_back(static_cast<std::uint8_t>(80 + 2 * u));
      rgb.push_back(static_cast<std::uint8_t>(60 + 3 * v));
      rgb.push_back(50);
    }
  }
  return rgb;
}

EncodedPicture jpeg_picture(const std::vector<std::uint8_t>& data) {
  return {kWidth, kHeight, 0, PixelFormat::kMjpeg, data};
}

void expect_gradient(PictureDecoder& decoder) {
  const std::vector<std::uint8_t> jpeg = to_jpeg(gradient(), kWidth, kHeight);
  std::vector<std::uint8_t> rgb;
  ASSERT_FALSE(decoder.decode(jpeg_picture(jpeg), rgb));
  const std::vector<std::uint8_t> expected = gradient();
  ASSERT_EQ(rgb.size(), expected.size());
  for (std::size_t i = 0; i < rgb.size(); ++i) EXPECT_NEAR(rgb[i], expected[i], kJpegError);
}

TEST(PictureDecoder, JpegComesOutAsItWentIn) {
  PictureDecoder decoder(kWidth, kHeight);
  expect_gradient(decoder);
}

TEST(PictureDecoder, GreyJpegHasThreeEqualChannels) {
  std::vector<std::uint8_t> grey(kWidth * kHeight, 130);
  const std::vector<std::uint8_t> jpeg = to_jpeg(grey, kWidth, kHeight, TJPF_GRAY);
  PictureDecoder decoder(kWidth, kHeight);
  std::vector<std::uint8_t> rgb;
  ASSERT_FALSE(decoder.decode(jpeg_picture(jpeg), rgb));
  for (const std::uint8_t level : rgb) EXPECT_NEAR(level, 130, kJpegError);
}

TEST(PictureDecoder, EveryTruncationIsRefusedAndTheNextGoodPictureWorks) {
  const std::vector<std::uint8_t> jpeg = to_jpeg(gradient(), kWidth, kHeight);
  PictureDecoder decoder(kWidth, kHeight);
  std::vector<std::uint8_t> rgb;
  // The last two bytes are the end marker, without which nothing is missing but the marker.
  for (std::size_t size = 0; size + 2 < jpeg.size(); size += 7) {
    const std::vector<std::uint8_t> truncated(jpeg.begin(),
                                              jpeg.begin() + static_cast<std::ptrdiff_t>(size));
    EXPECT_THAT(decoder.decode(jpeg_picture(truncated), rgb).message, HasSubstr("corrupt JPEG"))
        << size;
    expect_gradient(decoder);
  }
}

TEST(PictureDecoder, OtherSizesAreRefusedBeforeAnythingIsDecoded) {
  PictureDecoder decoder(kWidth, kHeight);
  std::vector<std::uint8_t> rgb;
  const std::vector<std::uint8_t> other = to_jpeg({1, 2, 3}, 1, 1);
  EXPECT_THAT(decoder.decode(jpeg_picture(other), rgb).message, HasSubstr("1x1"));
  std::vector<std::uint8_t> huge = to_jpeg(gradient(), kWidth, kHeight);
  // The frame header (FF C0, length, precision, height, width) claims 32639 x 32639.
  const std::vector<std::uint8_t> marker = {0xFF, 0xC0};
  const auto header = std::search(huge.begin(), huge.end(), marker.begin(), marker.end());
  ASSERT_NE(header, huge.end());
  std::fill_n(header + 5, 4, std::uint8_t{0x7F});
  EXPECT_THAT(decoder.decode(jpeg_picture(huge), rgb).message, HasSubstr("32639x32639"));
  // The message's own words count too.
  EXPECT_THAT(decoder.decode({640, 480, 0, PixelFormat::kMjpeg, huge}, rgb).message,
              HasSubstr("640x480"));
  expect_gradient(decoder);
}

TEST(PictureDecoder, RawPicturesAreTakenWithTheirPadding) {
  PictureDecoder decoder(2, 2);
  std::vector<std::uint8_t> rgb;
  const std::vector<std::uint8_t> padded = {1, 2, 3, 4, 5, 6, 99, 7, 8, 9, 10, 11, 12};
  ASSERT_FALSE(decoder.decode({2, 2, 7, PixelFormat::kRgb, padded}, rgb));
  EXPECT_THAT(rgb, ElementsAre(1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12));
  ASSERT_FALSE(decoder.decode({2, 2, 7, PixelFormat::kBgr, padded}, rgb));
  EXPECT_THAT(rgb, ElementsAre(3, 2, 1, 6, 5, 4, 9, 8, 7, 12, 11, 10));
  const std::vector<std::uint8_t> grey = {1, 2, 3, 4};
  ASSERT_FALSE(decoder.decode({2, 2, 2, PixelFormat::kGray, grey}, rgb));
  EXPECT_THAT(rgb, ElementsAre(1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4));
}

TEST(PictureDecoder, RawPicturesThatDoNotHoldTheirPixelsAreRefused) {
  PictureDecoder decoder(2, 2);
  std::vector<std::uint8_t> rgb;
  const std::vector<std::uint8_t> eleven(11);
  const std::vector<std::uint8_t> twelve(12);
  EXPECT_THAT(decoder.decode({2, 2, 6, PixelFormat::kRgb, eleven}, rgb).message,
              HasSubstr("too small"));
  EXPECT_THAT(decoder.decode({2, 2, 5, PixelFormat::kRgb, twelve}, rgb).message,
              HasSubstr("too small"));
  EXPECT_THAT(decoder.decode({2, 2, -6, PixelFormat::kRgb, twelve}, rgb).message,
              HasSubstr("too small"));
  EXPECT_THAT(decoder.decode({2, 2, 2147483647, PixelFormat::kRgb, twelve}, rgb).message,
              HasSubstr("too small"));
  EXPECT_FALSE(decoder.decode({2, 2, 6, PixelFormat::kRgb, twelve}, rgb));
}

}  // namespace
}  // namespace gastronaut::perception

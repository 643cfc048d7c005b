#include "evaluate/pictures.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <opencv2/imgcodecs.hpp>

namespace gastronaut::evaluation {
namespace {

constexpr int kWidth = 48;
constexpr int kHeight = 32;
// Levels are rounded, and OpenCV looks up to 1/32 pixel: half of it on a ramp of 4 levels a pixel.
constexpr double kRounding = 0.5 + 4.0 / 64;

std::vector<std::uint8_t> jpeg(int width, int height) {
  std::vector<std::uint8_t> bytes;
  cv::imencode(".jpg", cv::Mat(height, width, CV_8UC3, cv::Scalar(40, 120, 200)), bytes);
  return bytes;
}

TEST(DecodeColourTest, ReadsEachEncodingAsBlueGreenRed) {
  const std::vector<std::uint8_t> red_first = {200, 120, 40};
  const std::vector<std::uint8_t> blue_first = {40, 120, 200};
  const std::array<std::uint8_t, 3> expected = {40, 120, 200};
  EXPECT_EQ(decode_colour(PictureEncoding::kRgb, red_first, 1, 1, 0)->at(0, 0), expected);
  EXPECT_EQ(decode_colour(PictureEncoding::kBgr, blue_first, 1, 1, 3)->at(0, 0), expected);
  EXPECT_EQ(decode_colour(PictureEncoding::kGray, blue_first, 1, 1, 0)->at(0, 0)[2], 40);
  const auto picture =
      decode_colour(PictureEncoding::kJpeg, jpeg(kWidth, kHeight), kWidth, kHeight, 0);
  ASSERT_TRUE(picture);
  constexpr int kJpegLoss = 3;  // levels, of an even picture at quality 95
  for (std::size_t channel = 0; channel < 3; ++channel) {
    EXPECT_NEAR(picture->at(kWidth / 2, kHeight / 2)[channel], expected[channel], kJpegLoss);
  }
}

TEST(DecodeColourTest, RefusesDamagedJpegAndWrongSizes) {
  std::vector<std::uint8_t> bytes = jpeg(kWidth, kHeight);
  EXPECT_FALSE(decode_colour(PictureEncoding::kJpeg, bytes, kHeight, kWidth, 0));
  EXPECT_FALSE(decode_colour(PictureEncoding::kJpeg, bytes, -kWidth, -kHeight, 0));
  EXPECT_FALSE(decode_colour(PictureEncoding::kJpeg, bytes, 1 << 20, 1 << 20, 0));
  EXPECT_FALSE(decode_colour(PictureEncoding::kJpeg, {}, kWidth, kHeight, 0));
  bytes.resize(bytes.size() / 2);
  EXPECT_FALSE(decode_colour(PictureEncoding::kJpeg, bytes, kWidth, kHeight, 0));
  EXPECT_FALSE(decode_colour(PictureEncoding::kRgb, bytes, kWidth, kHeight, 0));
}

TEST(DecodeLevelsTest, LeavesOutThePaddingOfRows) {
  const std::vector<std::uint8_t> padded = {1, 2, 99, 3, 4};
  EXPECT_EQ(decode_levels(padded, 2, 2, 3)->values, (std::vector<std::uint8_t>{1, 2, 3, 4}));
  EXPECT_FALSE(decode_levels(padded, 2, 2, 4));  // too few bytes
  EXPECT_FALSE(decode_levels(padded, 2, 2, 1));  // rows would overlap
  EXPECT_FALSE(decode_levels(padded, 2, 2, -3));
}

TEST(FinerGridTest, UndoesTheBinningOfAWholeNumberOfPixels) {
  // Coarse pixel 0 of three binned ones has its centre on fine pixel 1.
  DepthPicture coarse{16, 10, 11, 12, (161.8 - 1) / 3, (117.8 - 1) / 3, {}};
  const auto grid = finer_grid(coarse, kWidth, 30);
  ASSERT_TRUE(grid);
  EXPECT_DOUBLE_EQ(grid->fx, 33);
  EXPECT_DOUBLE_EQ(grid->fy, 36);
  EXPECT_DOUBLE_EQ(grid->cx, 161.8);
  EXPECT_DOUBLE_EQ(grid->cy, 117.8);
  EXPECT_FALSE(finer_grid(coarse, kWidth + 1, 30));
  EXPECT_FALSE(finer_grid(coarse, kWidth, 20));
  EXPECT_FALSE(finer_grid(coarse, 8, 5));
}

TEST(UndistorterTest, BringsAPointWhereThePinholeSeesIt) {
  CameraIntrinsics camera{kWidth, kHeight, 30, 30, 24, 16, LensModel::kRadialTangential, {-0.2}};
  // A ramp along the columns: its level tells where a pixel came from.
  ColourPicture ramp(kWidth, kHeight);
  for (int v = 0; v < kHeight; ++v) {
    for (int u = 0; u < kWidth; ++u) ramp.at(u, v).fill(static_cast<std::uint8_t>(4 * u));
  }
  const Undistorter undistorter(camera, {kWidth, kHeight, 30, 30, 24, 16});
  const Levels seen = luminance(undistorter.undistort(ramp));
  EXPECT_EQ(seen.at(24, 16), 4 * 24);  // the principal point stays
  const double x = 12.0 / 30;          // of column 36; r' = r (1 - 0.2 r^2) by hand
  EXPECT_NEAR(seen.at(36, 16), 4 * (24 + 30 * x * (1 - 0.2 * x * x)), kRounding);
}

TEST(EqualiseContrastTest, WorksOnPicturesSmallerThanItsTiles) {
  const Levels one(1, 1, 100);
  EXPECT_TRUE(equalise_contrast(one).same_size(1, 1));
}

}  // namespace
}  // namespace gastronaut::evaluation

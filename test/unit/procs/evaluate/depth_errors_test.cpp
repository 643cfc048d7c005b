#include "evaluate/depth_errors.hpp"

#include <gtest/gtest.h>
#include <zstd.h>

#include <cmath>
#include <opencv2/imgcodecs.hpp>

namespace gastronaut::evaluation {
namespace {

constexpr double kSinglePrecision = 1e-6;  // relative, of depths kept as float

std::vector<std::uint8_t> bytes_of(const std::vector<std::uint16_t>& counts) {
  std::vector<std::uint8_t> bytes;
  for (const std::uint16_t count : counts) {
    bytes.push_back(static_cast<std::uint8_t>(count & 0xFF));
    bytes.push_back(static_cast<std::uint8_t>(count >> 8));
  }
  return bytes;
}

class EncodingTest : public testing::Test {
 protected:
  static constexpr int kWidth = 7;
  static constexpr int kHeight = 5;
  EncodingTest() {
    for (int i = 0; i < kWidth * kHeight; ++i) {
      counts_.push_back(static_cast<std::uint16_t>(1800 * i));
    }
    raw_ = bytes_of(counts_);
    cv::imencode(".png", cv::Mat(kHeight, kWidth, CV_16U, counts_.data()), png_);
    zstd_.resize(ZSTD_compressBound(raw_.size()));
    zstd_.resize(ZSTD_compress(zstd_.data(), zstd_.size(), raw_.data(), raw_.size(), 1));
  }
  std::vector<std::uint16_t> counts_;
  std::vector<std::uint8_t> raw_;
  std::vector<std::uint8_t> png_;
  std::vector<std::uint8_t> zstd_;
};

TEST_F(EncodingTest, AllThreeDecodeToTheSameCounts) {
  EXPECT_EQ(decode_depth_counts(DepthEncoding::kRaw, raw_, kWidth, kHeight), counts_);
  EXPECT_EQ(decode_depth_counts(DepthEncoding::kPng, png_, kWidth, kHeight), counts_);
  EXPECT_EQ(decode_depth_counts(DepthEncoding::kZstd, zstd_, kWidth, kHeight), counts_);
}

TEST_F(EncodingTest, DamagedOrMismatchedDataAreRefused) {
  for (auto [encoding, data] :
       {std::pair{DepthEncoding::kRaw, raw_}, std::pair{DepthEncoding::kPng, png_},
        std::pair{DepthEncoding::kZstd, zstd_}}) {
    EXPECT_FALSE(decode_depth_counts(encoding, data, kWidth + 1, kHeight));
    EXPECT_FALSE(decode_depth_counts(encoding, data, -kWidth, -kHeight));
    EXPECT_FALSE(decode_depth_counts(encoding, {}, kWidth, kHeight));
    data.resize(data.size() / 2);
    EXPECT_FALSE(decode_depth_counts(encoding, data, kWidth, kHeight));
  }
}

// A wall that leans: depth = offset + slope * x / z along the ray.
DepthPicture leaning_wall(int width, int height, double focal_length, double offset, double slope) {
  DepthPicture picture{
      width, height, focal_length, focal_length, (width - 1) / 2.0, (height - 1) / 2.0, {}};
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      picture.depth.push_back(static_cast<float>(offset + slope * (u - picture.cx) / focal_length));
    }
  }
  return picture;
}

TEST(CompareDepthTest, AConstantErrorShowsInEveryFigure) {
  const DepthPicture truth = leaning_wall(40, 30, 30, 0.04, 0);
  const DepthPicture estimate = leaning_wall(40, 30, 30, 0.042, 0);
  const DepthErrors errors = compare_depth(estimate, truth);
  EXPECT_EQ(errors.truth_pixels, 1200U);
  EXPECT_NEAR(errors.mean_absolute(), 0.002, kSinglePrecision);
  EXPECT_NEAR(errors.rmse(), 0.002, kSinglePrecision);
  EXPECT_NEAR(errors.mean_relative(), 0.05, kSinglePrecision);
  EXPECT_NEAR(errors.scale, 0.04 / 0.042, kSinglePrecision);
  EXPECT_NEAR(errors.mean_absolute_scaled(), 0, kSinglePrecision);
  EXPECT_EQ(errors.coverage(), 1);
}

TEST(CompareDepthTest, PixelsAreComparedAlongTheirRaysWhateverTheSizes) {
  const DepthPicture truth = leaning_wall(80, 60, 60, 0.04, 0.01);
  const DepthPicture estimate = leaning_wall(40, 30, 30, 0.04, 0.01);
  const DepthErrors errors = compare_depth(estimate, truth);
  // Half a pixel of the coarser picture at most between the rays.
  const double half_pixel = 0.5 * 0.01 / 30;
  EXPECT_LT(errors.rmse(), half_pixel);
  EXPECT_GT(errors.coverage(), 0.99);
}

TEST(CompareDepthTest, ASmallerViewCoversLess) {
  const DepthPicture truth = leaning_wall(80, 60, 60, 0.04, 0);
  const DepthPicture middle = leaning_wall(40, 60, 60, 0.04, 0);
  EXPECT_NEAR(compare_depth(middle, truth).coverage(), 0.5, 1e-12);
}

TEST(CompareDepthTest, PixelsWithoutDepthAreNotCompared) {
  DepthPicture truth = leaning_wall(10, 10, 10, 0.04, 0);
  DepthPicture estimate = truth;
  truth.depth[0] = 0;
  estimate.depth[0] = 1;
  estimate.depth[1] = 0;
  const DepthErrors errors = compare_depth(estimate, truth);
  EXPECT_EQ(errors.truth_pixels, 99U);
  EXPECT_EQ(errors.compared_pixels, 98U);
  EXPECT_EQ(errors.sum_absolute, 0);
}

TEST(CompareDepthTest, AnEmptyEstimateCoversNothing) {
  const DepthPicture truth = leaning_wall(10, 10, 10, 0.04, 0);
  DepthPicture estimate = truth;
  estimate.depth.assign(estimate.depth.size(), 0);
  const DepthErrors errors = compare_depth(estimate, truth);
  EXPECT_EQ(errors.coverage(), 0);
  EXPECT_TRUE(std::isnan(errors.mean_absolute()));
}

}  // namespace
}  // namespace gastronaut::evaluation

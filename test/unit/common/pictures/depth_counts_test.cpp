#include "pictures/depth_counts.hpp"

#include <gtest/gtest.h>
#include <zstd.h>

#include <opencv2/imgcodecs.hpp>
#include <utility>

namespace gastronaut {
namespace {

std::vector<std::uint8_t> bytes_of(const std::vector<std::uint16_t>& counts) {
  std::vector<std::uint8_t> bytes;
  for (const std::uint16_t count : counts) {
    bytes.push_back(static_cast<std::uint8_t>(count & 0xFF));
    bytes.push_back(static_cast<std::uint8_t>(count >> 8));
  }
  return bytes;
}

class DepthCountsTest : public testing::Test {
 protected:
  static constexpr int kWidth = 7;
  static constexpr int kHeight = 5;
  DepthCountsTest() {
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

TEST_F(DepthCountsTest, AllThreeDecodeToTheSameCounts) {
  EXPECT_EQ(decode_depth_counts(DepthEncoding::kRaw, raw_, kWidth, kHeight), counts_);
  EXPECT_EQ(decode_depth_counts(DepthEncoding::kPng, png_, kWidth, kHeight), counts_);
  EXPECT_EQ(decode_depth_counts(DepthEncoding::kZstd, zstd_, kWidth, kHeight), counts_);
}

TEST_F(DepthCountsTest, DamagedOrMismatchedDataAreRefused) {
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

TEST(DepthEncoding, UnknownNumbersAreNone) {
  EXPECT_EQ(depth_encoding(0), DepthEncoding::kRaw);
  EXPECT_EQ(depth_encoding(1), DepthEncoding::kPng);
  EXPECT_EQ(depth_encoding(2), DepthEncoding::kZstd);
  EXPECT_FALSE(depth_encoding(3));
  EXPECT_FALSE(depth_encoding(-1));
}

}  // namespace
}  // namespace gastronaut

#include "import/pictures.hpp"

#include <gtest/gtest.h>

#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>

namespace gastronaut {
namespace {

constexpr PictureSize kSize{48, 32};

cv::Mat colour_ramp() {
  cv::Mat picture(kSize.height, kSize.width, CV_8UC3);
  for (int v = 0; v < picture.rows; ++v) {
    for (int u = 0; u < picture.cols; ++u) {
      picture.at<cv::Vec3b>(v, u) = {static_cast<uchar>(4 * u), static_cast<uchar>(6 * v),
                                     static_cast<uchar>(2 * u + 3 * v)};
    }
  }
  return picture;
}

std::vector<std::uint8_t> encoded(const char* extension, const cv::Mat& picture) {
  std::vector<std::uint8_t> bytes;
  cv::imencode(extension, picture, bytes);
  return bytes;
}

TEST(JpegMaker, JpegPassesThroughUntouched) {
  const auto file = encoded(".jpg", colour_ramp());
  EXPECT_EQ(JpegMaker(kSize).to_jpeg(file), file);
}

TEST(JpegMaker, OtherFormatsAreEncodedOnceNearlyWithoutLoss) {
  const auto jpeg = JpegMaker(kSize).to_jpeg(encoded(".png", colour_ramp()));
  const cv::Mat decoded = cv::imdecode(jpeg, cv::IMREAD_COLOR);
  // Quality 95 quantises the smooth ramp's coefficients by a few grey levels.
  constexpr double kQuality95 = 4;
  EXPECT_LE(cv::norm(decoded, colour_ramp(), cv::NORM_INF), kQuality95);
}

TEST(JpegMaker, DamagedAndForeignFilesAreRefused) {
  JpegMaker maker(kSize);
  auto cut = encoded(".jpg", colour_ramp());
  cut.resize(cut.size() / 2);
  EXPECT_THROW(maker.to_jpeg(cut), std::runtime_error);
  auto cut_png = encoded(".png", colour_ramp());
  cut_png.resize(cut_png.size() / 2);
  EXPECT_THROW(maker.to_jpeg(cut_png), std::runtime_error);
  EXPECT_THROW(maker.to_jpeg({}), std::runtime_error);
  EXPECT_THROW(maker.to_jpeg({'h', 'e', 'l', 'l', 'o'}), std::runtime_error);
}

TEST(JpegMaker, ADamagedPictureDoesNotSpoilTheNext) {
  JpegMaker maker(kSize);
  const auto good = encoded(".jpg", colour_ramp());
  auto cut = good;
  constexpr std::size_t kBeforeTheScan = 100;  // bytes: the header is not complete
  cut.resize(kBeforeTheScan);
  EXPECT_THROW(maker.to_jpeg(cut), std::runtime_error);
  EXPECT_EQ(maker.to_jpeg(good), good);
}

TEST(JpegMaker, WrongSizeIsNamed) {
  try {
    JpegMaker({640, 480}).to_jpeg(encoded(".jpg", colour_ramp()));
    FAIL() << "a picture of the wrong size was taken";
  } catch (const std::runtime_error& problem) {
    EXPECT_STREQ(problem.what(), "is 48x32, but the camera's configuration says 640x480");
  }
}

TEST(DecodeDepth, CountsComeRowByRow) {
  cv::Mat depth(kSize.height, kSize.width, CV_16UC1, cv::Scalar(1000));
  depth.at<std::uint16_t>(1, 2) = 65535;
  const auto counts = decode_depth(encoded(".png", depth), kSize);
  ASSERT_EQ(counts.size(), static_cast<std::size_t>(kSize.width * kSize.height));
  EXPECT_EQ(counts[0], 1000);
  EXPECT_EQ(counts[static_cast<std::size_t>(kSize.width) + 2], 65535);
}

TEST(DecodeDepth, EightBitsAreNoDepth) {
  EXPECT_THROW(decode_depth(encoded(".png", colour_ramp()), kSize), std::runtime_error);
}

}  // namespace
}  // namespace gastronaut

#include "uvc_camera/picture.hpp"

#include <gmock/gmock.h>

#include <algorithm>

#include "unit/drivers/uvc_camera/test_pictures.hpp"

namespace gastronaut {
namespace {

using ::testing::HasSubstr;
constexpr int kWidth = 320;
constexpr int kHeight = 240;

std::string problem(const std::vector<std::uint8_t>& data) {
  return picture_problem(PictureEncoding::kMjpeg, kWidth, kHeight, data);
}

TEST(PictureProblem, AWholeJpegHasNoneNotEvenWithFillBehindIt) {
  std::vector<std::uint8_t> jpeg = jpeg_picture(kWidth, kHeight, 1);
  EXPECT_EQ(problem(jpeg), "");
  jpeg.resize(jpeg.size() + 500, 0);
  EXPECT_EQ(problem(jpeg), "");
}

TEST(PictureProblem, AJpegCutAnywhereHasOne) {
  const std::vector<std::uint8_t> jpeg = jpeg_picture(kWidth, kHeight, 2);
  for (std::size_t size = 0; size + 1 < jpeg.size(); size += 97) {
    EXPECT_NE(problem({jpeg.begin(), jpeg.begin() + static_cast<std::ptrdiff_t>(size)}), "");
  }
}

TEST(PictureProblem, APacketThatIsMissingInTheMiddleIsSeen) {
  constexpr std::size_t kPacket = 1012;
  int seen = 0;
  int all = 0;
  for (int number = 0; number < 50; ++number) {
    std::vector<std::uint8_t> jpeg = jpeg_picture(kWidth, kHeight, number);
    ASSERT_GT(jpeg.size(), 4 * kPacket);
    const auto begin = jpeg.begin() + static_cast<std::ptrdiff_t>(2 * kPacket);
    jpeg.erase(begin, begin + kPacket);
    ++all;
    seen += problem(jpeg).empty() ? 0 : 1;
  }
  EXPECT_EQ(seen, all);
}

TEST(PictureProblem, AnotherSizeIsNamed) {
  EXPECT_THAT(problem(jpeg_picture(160, 120, 1)), HasSubstr("160x120"));
  EXPECT_THAT(picture_problem(PictureEncoding::kYuyv, kWidth, kHeight,
                              yuyv_picture(kWidth, kHeight - 1, 1)),
              HasSubstr("not 153600"));
  EXPECT_EQ(
      picture_problem(PictureEncoding::kYuyv, kWidth, kHeight, yuyv_picture(kWidth, kHeight, 1)),
      "");
}

TEST(EncodeJpeg, BrightnessAndColoursStay) {
  Picture picture;
  picture.encoding = PictureEncoding::kYuyv;
  picture.width = kWidth;
  picture.height = kHeight;
  picture.data = yuyv_picture(kWidth, kHeight, 3);
  const std::vector<std::uint8_t> jpeg = encode_jpeg(picture);
  ASSERT_EQ(problem(jpeg), "");
  constexpr std::size_t kPixels = std::size_t{kWidth} * kHeight;
  std::vector<std::uint8_t> planes(kPixels * 2);
  tjhandle decoder = tjInitDecompress();
  ASSERT_EQ(
      tjDecompressToYUV2(decoder, jpeg.data(), jpeg.size(), planes.data(), kWidth, 1, kHeight, 0),
      0);
  tjDestroy(decoder);
  double luma = 0;
  double blue = 0;
  for (std::size_t i = 0; i < kPixels; ++i) {
    luma += std::abs(planes[i] - picture.data[2 * i]);
    blue += std::abs(planes[kPixels + i / 2] - picture.data[4 * (i / 2) + 1]);
  }
  // Quality 95 divides the coefficients by 1 to 10: an error of about a level.
  constexpr double kMeanError = 2;
  EXPECT_LT(luma / kPixels, kMeanError);
  EXPECT_LT(blue / kPixels, kMeanError);
}

}  // namespace
}  // namespace gastronaut

#include "import/pictures.hpp"

#include <turbojpeg.h>

#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>

namespace gastronaut {
namespace {

void check_size(int width, int height, PictureSize expected) {
  if (width == expected.width && height == expected.height) return;
  throw std::runtime_error("is " + std::to_string(width) + "x" + std::to_string(height) +
                           ", but the camera's configuration says " +
                           std::to_string(expected.width) + "x" + std::to_string(expected.height));
}

cv::Mat decode(const std::vector<std::uint8_t>& file, int mode) {
  if (file.empty()) throw std::runtime_error("is empty");
  cv::Mat picture;
  try {
    picture = cv::imdecode(file, mode);
  } catch (const cv::Exception& problem) {
    throw std::runtime_error("cannot be decoded: " + problem.err);
  }
  if (picture.empty()) throw std::runtime_error("is damaged or not a picture");
  return picture;
}

}  // namespace

JpegMaker::JpegMaker(PictureSize expected)
    : expected_(expected),
      compressor_(tjInitCompress()),
      luminance_(static_cast<std::size_t>(expected.width) *
                 static_cast<std::size_t>(expected.height)) {
  if (compressor_ == nullptr) {
    throw std::runtime_error(std::string("turbojpeg cannot be used: ") + tjGetErrorStr2(nullptr));
  }
}

JpegMaker::~JpegMaker() { tjDestroy(compressor_); }

void JpegMaker::check(const std::vector<std::uint8_t>& jpeg) {
  // A fresh one each time: a damaged picture can spoil turbojpeg's instance for the next (2.1.5).
  const std::unique_ptr<void, decltype(&tjDestroy)> decompressor(tjInitDecompress(), &tjDestroy);
  int width = 0;
  int height = 0;
  int subsampling = 0;
  int colourspace = 0;
  const auto damaged = [&decompressor] {
    return std::runtime_error(std::string("is a damaged JPEG: ") +
                              tjGetErrorStr2(decompressor.get()));
  };
  if (tjDecompressHeader3(decompressor.get(), jpeg.data(), jpeg.size(), &width, &height,
                          &subsampling, &colourspace) != 0) {
    throw damaged();
  }
  check_size(width, height, expected_);
  if (tjDecompress2(decompressor.get(), jpeg.data(), jpeg.size(), luminance_.data(), width, 0,
                    height, TJPF_GRAY, 0) != 0) {
    throw damaged();
  }
}

std::vector<std::uint8_t> JpegMaker::to_jpeg(std::vector<std::uint8_t> file) {
  constexpr std::uint8_t kMarker = 0xFF;
  constexpr std::uint8_t kStartOfImage = 0xD8;
  if (file.size() >= 2 && file[0] == kMarker && file[1] == kStartOfImage) {
    check(file);
    return file;
  }
  const cv::Mat picture = decode(file, cv::IMREAD_COLOR);
  check_size(picture.cols, picture.rows, expected_);
  return encode(picture);
}

std::vector<std::uint8_t> JpegMaker::encode(const cv::Mat& bgr) {
  constexpr int kQuality = 95;
  if (bgr.type() != CV_8UC3) throw std::runtime_error("is not an 8-bit colour picture");
  check_size(bgr.cols, bgr.rows, expected_);
  unsigned char* buffer = nullptr;
  unsigned long size = 0;
  const int failed =
      tjCompress2(compressor_, bgr.data, bgr.cols, static_cast<int>(bgr.step), bgr.rows, TJPF_BGR,
                  &buffer, &size, TJSAMP_444, kQuality, TJFLAG_ACCURATEDCT);
  const std::unique_ptr<unsigned char, decltype(&tjFree)> owner(buffer, &tjFree);
  if (failed != 0) {
    throw std::runtime_error(std::string("cannot be encoded: ") + tjGetErrorStr2(compressor_));
  }
  return {buffer, buffer + size};
}

std::vector<std::uint16_t> decode_depth(const std::vector<std::uint8_t>& file,
                                        PictureSize expected) {
  const cv::Mat picture = decode(file, cv::IMREAD_UNCHANGED);
  if (picture.type() != CV_16UC1) throw std::runtime_error("is not a 16-bit grey picture");
  check_size(picture.cols, picture.rows, expected);
  return {picture.begin<std::uint16_t>(), picture.end<std::uint16_t>()};
}

}  // namespace gastronaut

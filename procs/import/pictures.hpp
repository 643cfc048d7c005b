// Picture files: JPEG bytes that decode, whatever they came as, and depth as counts.
#pragma once

#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <string>
#include <vector>

namespace gastronaut {

struct PictureSize {
  int width = 0;  // pixels
  int height = 0;
};

// Turns picture files into JPEG. One object a thread.
class JpegMaker {
 public:
  explicit JpegMaker(PictureSize expected);
  ~JpegMaker();
  JpegMaker(const JpegMaker&) = delete;
  JpegMaker& operator=(const JpegMaker&) = delete;

  // JPEG passes through untouched, anything else that OpenCV reads is encoded once, at quality 95
  // without chroma subsampling. Throws std::runtime_error for what is damaged, not a picture, or
  // not of the expected size.
  std::vector<std::uint8_t> to_jpeg(std::vector<std::uint8_t> file);
  // `bgr`: 8 bits, three channels.
  std::vector<std::uint8_t> encode(const cv::Mat& bgr);

 private:
  void check(const std::vector<std::uint8_t>& jpeg);

  PictureSize expected_;
  void* compressor_;
  std::vector<std::uint8_t> luminance_;
};

// A 16-bit single-channel picture as counts, row by row. Throws as to_jpeg does.
std::vector<std::uint16_t> decode_depth(const std::vector<std::uint8_t>& file,
                                        PictureSize expected);

}  // namespace gastronaut

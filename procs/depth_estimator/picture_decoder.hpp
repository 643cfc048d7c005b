// Any picture that a camera driver may send, as rows of red, green, blue bytes.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

namespace gastronaut::perception {

enum class PixelFormat { kMjpeg, kGray, kRgb, kBgr };

// Why a picture cannot be used: one word for programs (`kind`: "corrupt", "size", "black", "white",
// "veiled", "unlit", "unexplained") and a sentence for people. Both empty: it can.
struct PictureFailure {
  std::string kind;
  std::string message;
  explicit operator bool() const { return !kind.empty(); }
};

struct EncodedPicture {
  int width = 0;  // pixels, as the message says
  int height = 0;
  int row_stride = 0;  // bytes; not looked at for kMjpeg
  PixelFormat format = PixelFormat::kMjpeg;
  std::span<const std::uint8_t> data;
};

// Pictures of one size. Grey ones come out with three equal channels. After a damaged JPEG the
// next one gets a new decompressor: turbojpeg 2.1.5 may refuse a good picture with the old one.
class PictureDecoder {
 public:
  PictureDecoder(int width, int height);  // pixels

  // Fills `rgb` (3 * width * height bytes); after a failure it holds anything. A JPEG that ends
  // early is wrong, not half grey, and nothing is allocated for a size that is not the
  // constructor's.
  PictureFailure decode(const EncodedPicture& picture, std::vector<std::uint8_t>& rgb);

 private:
  struct Destroy {
    void operator()(void* decompressor) const;
  };
  PictureFailure decode_jpeg(std::span<const std::uint8_t> data, std::uint8_t* rgb);
  PictureFailure copy_pixels(const EncodedPicture& picture, std::uint8_t* rgb) const;
  PictureFailure wrong_size(int width, int height) const;

  int width_;
  int height_;
  std::unique_ptr<void, Destroy> decompressor_;
};

}  // namespace gastronaut::perception

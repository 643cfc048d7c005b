#include "depth_estimator/picture_decoder.hpp"

#include <fmt/format.h>
#include <turbojpeg.h>

#include <cstring>
#include <stdexcept>

namespace gastronaut::perception {

void PictureDecoder::Destroy::operator()(void* decompressor) const { tjDestroy(decompressor); }

PictureDecoder::PictureDecoder(int width, int height) : width_(width), height_(height) {}

PictureFailure PictureDecoder::decode(const EncodedPicture& picture,
                                      std::vector<std::uint8_t>& rgb) {
  if (picture.width != width_ || picture.height != height_) {
    return wrong_size(picture.width, picture.height);
  }
  rgb.resize(3 * static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_));
  if (picture.format != PixelFormat::kMjpeg) return copy_pixels(picture, rgb.data());
  PictureFailure failure = decode_jpeg(picture.data, rgb.data());
  if (failure) decompressor_.reset();
  return failure;
}

PictureFailure PictureDecoder::decode_jpeg(std::span<const std::uint8_t> data, std::uint8_t* rgb) {
  if (!decompressor_) decompressor_.reset(tjInitDecompress());
  if (!decompressor_) throw std::runtime_error("the JPEG decoder cannot be started");
  int width = 0;
  int height = 0;
  int subsampling = 0;
  int colours = 0;
  const auto size = static_cast<unsigned long>(data.size());
  if (tjDecompressHeader3(decompressor_.get(), data.data(), size, &width, &height, &subsampling,
                          &colours) != 0) {
    return {"corrupt", fmt::format("corrupt JPEG: {}", tjGetErrorStr2(decompressor_.get()))};
  }
  if (width == 0 || height == 0) return {"corrupt", "corrupt JPEG: it ends within its header"};
  if (width != width_ || height != height_) return wrong_size(width, height);
  // Warnings (the data end early, or make no sense) fail as errors do.
  if (tjDecompress2(decompressor_.get(), data.data(), size, rgb, width_, 0, height_, TJPF_RGB,
                    TJFLAG_LIMITSCANS) != 0) {
    return {"corrupt", fmt::format("corrupt JPEG: {}", tjGetErrorStr2(decompressor_.get()))};
  }
  return {};
}

PictureFailure PictureDecoder::copy_pixels(const EncodedPicture& picture, std::uint8_t* rgb) const {
  const int channels = picture.format == PixelFormat::kGray ? 1 : 3;
  const auto row = static_cast<std::size_t>(width_ * channels);
  const auto rows = static_cast<std::size_t>(height_);
  if (picture.row_stride < width_ * channels ||
      picture.data.size() < (rows - 1) * static_cast<std::size_t>(picture.row_stride) + row) {
    return {"corrupt",
            fmt::format("picture of {} bytes with rows of {} is too small for {}x{} pixels of {}",
                        picture.data.size(), picture.row_stride, width_, height_, channels)};
  }
  const std::size_t red = picture.format == PixelFormat::kBgr ? 2 : 0;
  for (std::size_t v = 0; v < rows; ++v) {
    const std::uint8_t* from =
        picture.data.data() + v * static_cast<std::size_t>(picture.row_stride);
    std::uint8_t* to = rgb + v * 3 * static_cast<std::size_t>(width_);
    if (picture.format == PixelFormat::kRgb) {
      std::memcpy(to, from, row);
      continue;
    }
    for (std::size_t u = 0; u < static_cast<std::size_t>(width_); ++u) {
      const std::uint8_t* pixel = from + u * static_cast<std::size_t>(channels);
      to[3 * u] = channels == 1 ? pixel[0] : pixel[red];
      to[3 * u + 1] = channels == 1 ? pixel[0] : pixel[1];
      to[3 * u + 2] = channels == 1 ? pixel[0] : pixel[2 - red];
    }
  }
  return {};
}

PictureFailure PictureDecoder::wrong_size(int width, int height) const {
  return {"size",
          fmt::format("picture is {}x{}, the configuration says {}x{}: load the camera's own",
                      width, height, width_, height_)};
}

}  // namespace gastronaut::perception

#include "evaluate/pictures.hpp"

#include <turbojpeg.h>

#include <cstring>
#include <memory>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

namespace gastronaut::evaluation {
namespace {

constexpr int kLargestSide = 16384;

// OpenCV's view of pixels that stay ours. It takes no const; sources are only read.
template <class Value>
cv::Mat view(const Plane<Value>& plane, int type) {
  return {plane.height, plane.width, type, const_cast<Value*>(plane.values.data())};
}

std::optional<ColourPicture> decode_jpeg(std::span<const std::uint8_t> data, int width,
                                         int height) {
  const std::unique_ptr<void, decltype(&tjDestroy)> decompressor(tjInitDecompress(), &tjDestroy);
  if (!decompressor) throw std::runtime_error("turbojpeg cannot be used");
  int coded_width = 0;
  int coded_height = 0;
  int subsampling = 0;
  int colourspace = 0;
  // The size is checked before anything is allocated for it.
  if (tjDecompressHeader3(decompressor.get(), data.data(), data.size(), &coded_width, &coded_height,
                          &subsampling, &colourspace) != 0 ||
      coded_width != width || coded_height != height) {
    return std::nullopt;
  }
  ColourPicture picture(width, height);
  if (tjDecompress2(decompressor.get(), data.data(), data.size(), picture.values.front().data(),
                    width, 0, height, TJPF_BGR, 0) != 0) {
    return std::nullopt;
  }
  return picture;
}

// Rows of `row_bytes` each, without the padding between them; nothing where data are too short.
std::optional<std::vector<std::uint8_t>> packed_rows(std::span<const std::uint8_t> data,
                                                     std::size_t row_bytes, int height,
                                                     int row_stride) {
  const std::size_t stride = row_stride == 0 ? row_bytes : static_cast<std::size_t>(row_stride);
  const auto rows = static_cast<std::size_t>(height);
  if (row_stride < 0 || stride < row_bytes || data.size() < stride * (rows - 1) + row_bytes) {
    return std::nullopt;
  }
  std::vector<std::uint8_t> packed(rows * row_bytes);
  for (std::size_t row = 0; row < rows; ++row) {
    std::memcpy(packed.data() + row * row_bytes, data.data() + row * stride, row_bytes);
  }
  return packed;
}

bool plausible_size(int width, int height) {
  return width > 0 && height > 0 && width <= kLargestSide && height <= kLargestSide;
}

}  // namespace

std::optional<ColourPicture> decode_colour(PictureEncoding encoding,
                                           std::span<const std::uint8_t> data, int width,
                                           int height, int row_stride) {
  if (!plausible_size(width, height)) return std::nullopt;
  if (encoding == PictureEncoding::kJpeg) return decode_jpeg(data, width, height);
  const std::size_t channels = encoding == PictureEncoding::kGray ? 1 : 3;
  const auto packed =
      packed_rows(data, channels * static_cast<std::size_t>(width), height, row_stride);
  if (!packed) return std::nullopt;
  ColourPicture picture(width, height);
  for (std::size_t i = 0; i < picture.size(); ++i) {
    const std::uint8_t* pixel = packed->data() + channels * i;
    if (channels == 1) {
      picture.values[i].fill(*pixel);
    } else if (encoding == PictureEncoding::kBgr) {
      picture.values[i] = {pixel[0], pixel[1], pixel[2]};
    } else {
      picture.values[i] = {pixel[2], pixel[1], pixel[0]};
    }
  }
  return picture;
}

std::optional<Levels> decode_levels(std::span<const std::uint8_t> data, int width, int height,
                                    int row_stride) {
  if (!plausible_size(width, height)) return std::nullopt;
  auto packed = packed_rows(data, static_cast<std::size_t>(width), height, row_stride);
  if (!packed) return std::nullopt;
  Levels levels;
  levels.width = width;
  levels.height = height;
  levels.values = std::move(*packed);
  return levels;
}

std::optional<PinholeGrid> finer_grid(const DepthPicture& coarse, int width, int height) {
  const int factor = width / coarse.width;
  if (factor < 1 || width != factor * coarse.width || height != factor * coarse.height) {
    return std::nullopt;
  }
  const double first = (factor - 1) / 2.0;  // centre of coarse pixel 0
  return PinholeGrid{width,
                     height,
                     factor * coarse.fx,
                     factor * coarse.fy,
                     factor * coarse.cx + first,
                     factor * coarse.cy + first};
}

Undistorter::Undistorter(const CameraIntrinsics& camera, const PinholeGrid& grid)
    : grid_(grid), columns_(grid.width, grid.height, -1), rows_(grid.width, grid.height, -1) {
  const CameraModel lens(camera);
  for (int v = 0; v < grid.height; ++v) {
    for (int u = 0; u < grid.width; ++u) {
      const auto pixel = lens.project({(u - grid.cx) / grid.fx, (v - grid.cy) / grid.fy, 1});
      // Further out the border would be mixed with black.
      if (!pixel || pixel->x() < 0 || pixel->y() < 0 || pixel->x() > camera.width - 1 ||
          pixel->y() > camera.height - 1) {
        continue;
      }
      columns_.at(u, v) = static_cast<float>(pixel->x());
      rows_.at(u, v) = static_cast<float>(pixel->y());
    }
  }
}

ColourPicture Undistorter::undistort(const ColourPicture& picture) const {
  ColourPicture result(grid_.width, grid_.height);
  cv::Mat target = view(result, CV_8UC3);
  cv::remap(view(picture, CV_8UC3), target, view(columns_, CV_32F), view(rows_, CV_32F),
            cv::INTER_LINEAR, cv::BORDER_CONSTANT);
  return result;
}

Levels luminance(const ColourPicture& picture) {
  Levels result(picture.width, picture.height);
  cv::Mat target = view(result, CV_8U);
  cv::cvtColor(view(picture, CV_8UC3), target, cv::COLOR_BGR2GRAY);
  return result;
}

Levels equalise_contrast(const Levels& picture) {
  constexpr double kClipLimit = 4;
  Levels result(picture.width, picture.height);
  cv::Mat target = view(result, CV_8U);
  cv::createCLAHE(kClipLimit)->apply(view(picture, CV_8U), target);
  return result;
}

}  // namespace gastronaut::evaluation

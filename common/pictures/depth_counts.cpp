#include "pictures/depth_counts.hpp"

#include <zstd.h>

#include <bit>
#include <cstring>
#include <opencv2/imgcodecs.hpp>

#include "gastronaut/depth_image_t.hpp"

namespace gastronaut {
namespace {

static_assert(std::endian::native == std::endian::little, "counts are copied as they are");

// Big-endian 32-bit number of a PNG header.
std::uint32_t png_number(std::span<const std::uint8_t> data, std::size_t at) {
  return (std::uint32_t{data[at]} << 24) | (std::uint32_t{data[at + 1]} << 16) |
         (std::uint32_t{data[at + 2]} << 8) | data[at + 3];
}

bool decode_png(std::span<const std::uint8_t> data, int width, int height,
                std::vector<std::uint16_t>& counts) {
  // The size is checked in the header, before the decoder allocates for it.
  constexpr std::size_t kWidthAt = 16;
  constexpr std::size_t kHeightAt = 20;
  constexpr std::size_t kHeaderEnd = 24;
  if (data.size() < kHeaderEnd || png_number(data, kWidthAt) != static_cast<unsigned>(width) ||
      png_number(data, kHeightAt) != static_cast<unsigned>(height)) {
    return false;
  }
  const cv::Mat bytes(1, static_cast<int>(data.size()), CV_8U,
                      const_cast<std::uint8_t*>(data.data()));  // Mat takes no const; only read
  cv::Mat picture;
  try {
    picture = cv::imdecode(bytes, cv::IMREAD_UNCHANGED);
  } catch (const cv::Exception&) {
    return false;
  }
  if (picture.type() != CV_16UC1 || picture.cols != width || picture.rows != height) return false;
  counts.assign(picture.begin<std::uint16_t>(), picture.end<std::uint16_t>());
  return true;
}

}  // namespace

std::optional<std::vector<std::uint16_t>> decode_depth_counts(DepthEncoding encoding,
                                                              std::span<const std::uint8_t> data,
                                                              int width, int height) {
  constexpr int kLargestSide = 16384;
  if (width <= 0 || height <= 0 || width > kLargestSide || height > kLargestSide) {
    return std::nullopt;
  }
  const std::size_t pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  std::vector<std::uint16_t> counts;
  switch (encoding) {
    case DepthEncoding::kRaw:
      if (data.size() != 2 * pixels) return std::nullopt;
      counts.resize(pixels);
      std::memcpy(counts.data(), data.data(), data.size());
      return counts;
    case DepthEncoding::kPng:
      if (!decode_png(data, width, height, counts)) return std::nullopt;
      return counts;
    case DepthEncoding::kZstd:
      if (ZSTD_getFrameContentSize(data.data(), data.size()) != 2 * pixels) return std::nullopt;
      counts.resize(pixels);
      if (ZSTD_decompress(counts.data(), 2 * pixels, data.data(), data.size()) != 2 * pixels) {
        return std::nullopt;
      }
      return counts;
  }
  return std::nullopt;
}

std::optional<DepthEncoding> depth_encoding(std::int8_t wire) {
  switch (wire) {
    case depth_image_t::ENCODING_RAW:
      return DepthEncoding::kRaw;
    case depth_image_t::ENCODING_PNG:
      return DepthEncoding::kPng;
    case depth_image_t::ENCODING_ZSTD:
      return DepthEncoding::kZstd;
    default:
      return std::nullopt;
  }
}

}  // namespace gastronaut

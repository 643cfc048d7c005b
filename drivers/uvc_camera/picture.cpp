#include "uvc_camera/picture.hpp"

#include <fmt/format.h>
#include <turbojpeg.h>

#include <array>
#include <memory>
#include <stdexcept>

namespace gastronaut {
namespace {

constexpr int kQuality = 95;  // encoded once, and measured on

struct Destroy {
  void operator()(void* handle) const { tjDestroy(handle); }
};
using Handle = std::unique_ptr<void, Destroy>;

std::string jpeg_problem(int width, int height, std::span<const std::uint8_t> data) {
  if (data.size() < 4 || data[0] != 0xff || data[1] != 0xd8) return "it does not begin as a JPEG";
  // Behind the end mark some cameras fill up.
  std::size_t end = data.size();
  while (end > 2 && !(data[end - 2] == 0xff && data[end - 1] == 0xd9)) --end;
  if (end == 2) return "its end is missing";
  thread_local const Handle decoder(tjInitDecompress());
  const auto size = static_cast<unsigned long>(end);
  int seen_width = 0, seen_height = 0, subsampling = 0, colours = 0;
  if (tjDecompressHeader3(decoder.get(), data.data(), size, &seen_width, &seen_height, &subsampling,
                          &colours) != 0) {
    return tjGetErrorStr2(decoder.get());
  }
  if (seen_width != width || seen_height != height) {
    return fmt::format("it is {}x{}, not {}x{}", seen_width, seen_height, width, height);
  }
  // An eighth of the size: all of the entropy-coded data is read, little is computed.
  const auto scaled = [](int pixels) { return (pixels + 7) / 8; };
  std::vector<std::uint8_t> grey(static_cast<std::size_t>(scaled(width)) *
                                 static_cast<std::size_t>(scaled(height)));
  if (tjDecompress2(decoder.get(), data.data(), size, grey.data(), scaled(width), 0, scaled(height),
                    TJPF_GRAY, TJFLAG_FASTDCT) != 0) {
    return tjGetErrorStr2(decoder.get());
  }
  return "";
}

}  // namespace

std::string picture_problem(PictureEncoding encoding, int width, int height,
                            std::span<const std::uint8_t> data) {
  if (encoding == PictureEncoding::kMjpeg) return jpeg_problem(width, height, data);
  const std::size_t expected =
      2 * static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  if (data.size() == expected) return "";
  return fmt::format("it has {} bytes, not {}", data.size(), expected);
}

std::vector<std::uint8_t> encode_jpeg(const Picture& picture) {
  const auto pixels =
      static_cast<std::size_t>(picture.width) * static_cast<std::size_t>(picture.height);
  std::array<std::vector<std::uint8_t>, 3> planes;
  planes[0].resize(pixels);
  planes[1].resize(pixels / 2);
  planes[2].resize(pixels / 2);
  for (std::size_t pair = 0; pair < pixels / 2; ++pair) {
    const std::uint8_t* yuyv = picture.data.data() + 4 * pair;
    planes[0][2 * pair] = yuyv[0];
    planes[1][pair] = yuyv[1];
    planes[0][2 * pair + 1] = yuyv[2];
    planes[2][pair] = yuyv[3];
  }
  std::array<const std::uint8_t*, 3> sources{planes[0].data(), planes[1].data(), planes[2].data()};
  thread_local const Handle encoder(tjInitCompress());
  unsigned char* jpeg = nullptr;
  unsigned long size = 0;
  if (tjCompressFromYUVPlanes(encoder.get(), sources.data(), picture.width, nullptr, picture.height,
                              TJSAMP_422, &jpeg, &size, kQuality, 0) != 0) {
    throw std::runtime_error(std::string("a picture cannot be encoded: ") +
                             tjGetErrorStr2(encoder.get()));
  }
  std::vector<std::uint8_t> result(jpeg, jpeg + size);
  tjFree(jpeg);
  return result;
}

}  // namespace gastronaut

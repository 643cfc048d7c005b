// A picture as the camera sent it, and whether it is one.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace gastronaut {

enum class PictureEncoding { kMjpeg, kYuyv };

struct Picture {
  PictureEncoding encoding = PictureEncoding::kMjpeg;
  int width = 0;  // pixels
  int height = 0;
  std::int64_t utime = 0;  // mid-exposure where the camera tells, else arrival of its first packet
  std::vector<std::uint8_t> data;
};

// What is wrong with `data`, empty if nothing: a JPEG of this size that decodes without complaint
// from its first byte to its end mark (fill may follow), or width x height pixels of two bytes.
std::string picture_problem(PictureEncoding encoding, int width, int height,
                            std::span<const std::uint8_t> data);

// YUYV (4:2:2, two bytes a pixel) as JPEG. `width` is even.
std::vector<std::uint8_t> encode_jpeg(const Picture& picture);

}  // namespace gastronaut

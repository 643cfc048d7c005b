// Pictures for the tests: textured, each of its own.
#pragma once

#include <turbojpeg.h>

#include <cmath>
#include <cstdint>
#include <vector>

namespace gastronaut {

// Two bytes a pixel, as a camera sends YUY2.
inline std::vector<std::uint8_t> yuyv_picture(int width, int height, int number) {
  std::vector<std::uint8_t> data;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const double wave =
          std::sin(0.11 * x + number) * std::cos(0.07 * y) + std::sin(0.5 * (x - y));
      data.push_back(static_cast<std::uint8_t>(std::lround(128 + 50 * wave)));
      data.push_back(static_cast<std::uint8_t>(x % 2 == 0 ? 110 : 150));
    }
  }
  return data;
}

// The same in grey, as JPEG.
inline std::vector<std::uint8_t> jpeg_picture(int width, int height, int number) {
  const std::vector<std::uint8_t> yuyv = yuyv_picture(width, height, number);
  std::vector<std::uint8_t> grey;
  for (std::size_t i = 0; i < yuyv.size(); i += 2) grey.push_back(yuyv[i]);
  tjhandle encoder = tjInitCompress();
  unsigned char* jpeg = nullptr;
  unsigned long size = 0;
  constexpr int kQuality = 85;
  tjCompress2(encoder, grey.data(), width, 0, height, TJPF_GRAY, &jpeg, &size, TJSAMP_GRAY,
              kQuality, 0);
  std::vector<std::uint8_t> result(jpeg, jpeg + size);
  tjFree(jpeg);
  tjDestroy(encoder);
  return result;
}

}  // namespace gastronaut

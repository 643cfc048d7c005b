// JPEG bytes for tests.
#pragma once

#include <turbojpeg.h>

#include <cstdint>
#include <vector>

namespace gastronaut::perception {

// `pixels`: rows of red, green, blue (or of grey, with TJPF_GRAY), without padding.
inline std::vector<std::uint8_t> to_jpeg(const std::vector<std::uint8_t>& pixels, int width,
                                         int height, TJPF format = TJPF_RGB) {
  constexpr int kQuality = 95;
  const tjhandle compressor = tjInitCompress();
  unsigned char* buffer = nullptr;
  unsigned long size = 0;
  tjCompress2(compressor, pixels.data(), width, 0, height, format, &buffer, &size,
              format == TJPF_GRAY ? TJSAMP_GRAY : TJSAMP_444, kQuality, 0);
  std::vector<std::uint8_t> jpeg(buffer, buffer + size);
  tjFree(buffer);
  tjDestroy(compressor);
  return jpeg;
}

}  // namespace gastronaut::perception

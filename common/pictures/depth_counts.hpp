// What a depth_image_t carries, unpacked.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

namespace gastronaut {

enum class DepthEncoding { kRaw, kPng, kZstd };

// Width * height little-endian 16-bit counts; nothing for data that are not just that.
std::optional<std::vector<std::uint16_t>> decode_depth_counts(DepthEncoding encoding,
                                                              std::span<const std::uint8_t> data,
                                                              int width, int height);

// Of the wire's number; nothing for one that is not known.
std::optional<DepthEncoding> depth_encoding(std::int8_t wire);

}  // namespace gastronaut

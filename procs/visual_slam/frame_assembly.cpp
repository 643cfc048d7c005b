#include "visual_slam/frame_assembly.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "numerics/parallel.hpp"

namespace gastronaut::slam {
namespace {

constexpr std::size_t kRowsAtOnce = 16;
constexpr int kMostInBlock = 64;       // depths looked at for one pixel
constexpr double kSameSurface = 0.05;  // as a fraction: the middle two may be averaged
constexpr double kSameRay = 0.02;  // pixels of the frame: the two grids look along the same rays

// The middle one of the depths in a block: a mean would put points between two surfaces.
float middle_depth(std::array<std::uint16_t, kMostInBlock>& counts, std::size_t size,
                   double metres_per_count) {
  const auto begin = counts.begin();
  const auto end = begin + static_cast<std::ptrdiff_t>(size);
  std::sort(begin, end);
  const double upper = counts[size / 2];
  const double lower = counts[(size - 1) / 2];
  const double counted = upper - lower < kSameSurface * lower ? (upper + lower) / 2 : lower;
  return static_cast<float>(counted * metres_per_count);
}

void check_sizes(const DepthCounts& depth, const AlbedoLevels& albedo, int max_width) {
  const auto pixels = [](const PinholeGrid& grid) {
    return grid.width > 0 && grid.height > 0
               ? static_cast<std::size_t>(grid.width) * static_cast<std::size_t>(grid.height)
               : 0;
  };
  if (max_width < 1 || pixels(depth.grid) == 0 || depth.counts.size() != pixels(depth.grid) ||
      albedo.levels.size() != pixels(albedo.grid)) {
    throw std::invalid_argument("depth or albedo has not as many values as its grid has pixels");
  }
}

// How many of albedo's pixels make one of the frame's.
int albedo_factor(const PinholeGrid& frame, const PinholeGrid& albedo) {
  const int factor = std::max(1, static_cast<int>(std::lround(albedo.fx / frame.fx)));
  const PinholeGrid coarse = albedo.coarser(factor);
  const auto differ = [](double a, double b) { return std::abs(a - b) > kSameRay; };
  if (coarse.width < frame.width || coarse.height < frame.height || differ(coarse.fx, frame.fx) ||
      differ(coarse.fy, frame.fy) || differ(coarse.cx, frame.cx) || differ(coarse.cy, frame.cy)) {
    throw std::invalid_argument(fmt::format(
        "albedo of {}x{} pixels, focal length {:.2f}, is not a whole number of times as fine as "
        "depth of {}x{}, {:.2f}; do both come from this camera?",
        albedo.width, albedo.height, albedo.fx, frame.width, frame.height, frame.fx));
  }
  return factor;
}

}  // namespace

Frame assemble_frame(std::int64_t utime, const DepthCounts& depth, const AlbedoLevels& albedo,
                     int max_width) {
  check_sizes(depth, albedo, max_width);
  const int factor = (depth.grid.width + max_width - 1) / max_width;
  Frame frame;
  frame.utime = utime;
  frame.grid = depth.grid.coarser(factor);
  frame.relative_std = depth.relative_std;
  const int fineness = albedo_factor(frame.grid, albedo.grid);
  frame.depth = Plane<float>(frame.grid.width, frame.grid.height);
  frame.albedo = Plane<float>(frame.grid.width, frame.grid.height);

  const int stride = (factor * factor + kMostInBlock - 1) / kMostInBlock;
  const auto depth_at = [&](int u, int v) {
    std::array<std::uint16_t, kMostInBlock> counts;
    std::size_t size = 0;
    int asked = 0;
    for (int k = 0; k < factor * factor && size < counts.size(); k += stride, ++asked) {
      const auto row = static_cast<std::size_t>(v * factor + k / factor);
      const auto column = static_cast<std::size_t>(u * factor + k % factor);
      const std::uint16_t count =
          depth.counts[row * static_cast<std::size_t>(depth.grid.width) + column];
      if (count > 0) counts[size++] = count;
    }
    return 2 * size >= static_cast<std::size_t>(asked) && size > 0
               ? middle_depth(counts, size, depth.metres_per_count)
               : 0.0F;
  };
  const auto albedo_at = [&](int u, int v) {
    int sum = 0;
    int known = 0;
    for (int j = 0; j < fineness; ++j) {
      for (int i = 0; i < fineness; ++i) {
        const auto row = static_cast<std::size_t>(v * fineness + j);
        const auto column = static_cast<std::size_t>(u * fineness + i);
        const int level = albedo.levels[row * static_cast<std::size_t>(albedo.grid.width) + column];
        sum += level;
        known += level > 0 ? 1 : 0;
      }
    }
    constexpr float kWhite = 255;
    return 2 * known >= fineness * fineness
               ? static_cast<float>(sum) / (kWhite * static_cast<float>(known))
               : -1.0F;
  };
  parallel_for_chunks(static_cast<std::size_t>(frame.grid.height), kRowsAtOnce,
                      [&](std::size_t begin, std::size_t end) {
                        for (int v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
                          for (int u = 0; u < frame.grid.width; ++u) {
                            frame.depth.at(u, v) = depth_at(u, v);
                            frame.albedo.at(u, v) = albedo_at(u, v);
                          }
                        }
                      });
  return frame;
}

}  // namespace gastronaut::slam

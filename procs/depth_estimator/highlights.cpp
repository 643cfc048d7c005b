#include "depth_estimator/highlights.hpp"

#include <algorithm>

#include "numerics/parallel.hpp"

namespace gastronaut::perception {
namespace {

constexpr int kBlock = 16;                // pixels: surroundings are 3 x 3 blocks
constexpr std::uint8_t kDark = 25;        // levels: darker pixels are no lit tissue
constexpr std::uint8_t kSaturated = 248;  // from here on a channel says nothing about colour
constexpr float kFaintest = 60;           // blue level: below, colour is noise
constexpr std::uint8_t kCertain = 246;    // all channels: white, whatever is around
// Blue level over what it is around, where tissue's own patterns end.
constexpr float kBrighterByFactor = 1.15F;
constexpr float kBrighterByLevels = 8;
// Blue over red, and over green where red is saturated, likewise. Tissue is red; what a film of
// mucus mirrors is as white as the lamp.
constexpr float kWhiterThanRed = 1.15F;
constexpr float kWhiterThanGreen = 1.05F;
constexpr std::size_t kRowsPerChunk = 16;

struct Colour {
  float red = 0;
  float green = 0;
  float blue = 0;
  float count = 0;

  void add(const Colour& other) {
    red += other.red;
    green += other.green;
    blue += other.blue;
    count += other.count;
  }
};

// Sums over the lit and unsaturated pixels of each block and its eight neighbours.
Plane<Colour> surroundings(const std::uint8_t* rgb, int width, int height) {
  const int columns = (width + kBlock - 1) / kBlock;
  const int rows = (height + kBlock - 1) / kBlock;
  Plane<Colour> sums(columns, rows);
  parallel_for_chunks(static_cast<std::size_t>(rows), 1, [&](std::size_t begin, std::size_t) {
    const int j = static_cast<int>(begin);
    for (int v = j * kBlock; v < std::min((j + 1) * kBlock, height); ++v) {
      for (int i = 0; i < columns; ++i) {
        int red = 0;
        int green = 0;
        int blue = 0;
        int count = 0;
        const std::uint8_t* end =
            rgb + 3 * (static_cast<std::ptrdiff_t>(v) * width + std::min((i + 1) * kBlock, width));
        for (const std::uint8_t* pixel =
                 rgb + 3 * (static_cast<std::ptrdiff_t>(v) * width + i * kBlock);
             pixel != end; pixel += 3) {
          const int counts = pixel[0] >= kDark && pixel[0] < kSaturated ? 1 : 0;
          red += counts * pixel[0];
          green += counts * pixel[1];
          blue += counts * pixel[2];
          count += counts;
        }
        sums.at(i, j).add({static_cast<float>(red), static_cast<float>(green),
                           static_cast<float>(blue), static_cast<float>(count)});
      }
    }
  });
  Plane<Colour> around(columns, rows);
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      for (int b = std::max(0, j - 1); b <= std::min(rows - 1, j + 1); ++b) {
        for (int a = std::max(0, i - 1); a <= std::min(columns - 1, i + 1); ++a) {
          around.at(i, j).add(sums.at(a, b));
        }
      }
    }
  }
  return around;
}

}  // namespace

void find_highlights(const std::uint8_t* rgb, int width, int height, Plane<std::uint8_t>& mask) {
  const Plane<Colour> around = surroundings(rgb, width, height);
  Plane<std::uint8_t> found(width, height);
  parallel_for_chunks(
      static_cast<std::size_t>(height), kRowsPerChunk, [&](std::size_t begin, std::size_t end) {
        for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
          std::uint8_t* to = found.row(v);
          for (int i = 0; i * kBlock < width; ++i) {
            const Colour& colour = around.at(i, v / kBlock);
            // All around is saturated: only white itself is certain.
            const bool known = colour.count > 0 && colour.blue > 0;
            const float least_blue =
                known ? std::max(kFaintest,
                                 kBrighterByFactor * colour.blue / colour.count + kBrighterByLevels)
                      : 255;
            const float over_red = known ? kWhiterThanRed * colour.blue / colour.red : 255;
            const float over_green = known ? kWhiterThanGreen * colour.blue / colour.green : 255;
            for (int u = i * kBlock; u < std::min((i + 1) * kBlock, width); ++u) {
              const std::uint8_t* pixel = rgb + 3 * (static_cast<std::ptrdiff_t>(v) * width + u);
              const auto red = static_cast<float>(pixel[0]);
              const auto green = static_cast<float>(pixel[1]);
              const auto blue = static_cast<float>(pixel[2]);
              const bool whiter =
                  pixel[0] < kSaturated ? blue > over_red * red : blue > over_green * green;
              const bool certain = std::min({pixel[0], pixel[1], pixel[2]}) >= kCertain;
              to[u] = certain || (whiter && blue > least_blue) ? 1 : 0;
            }
          }
        }
      });
  // A reflection's rim is half as bright: the pixels beside it do not count either.
  mask = Plane<std::uint8_t>(width, height);
  parallel_for_chunks(
      static_cast<std::size_t>(height), kRowsPerChunk, [&](std::size_t begin, std::size_t end) {
        std::vector<std::uint8_t> column(static_cast<std::size_t>(width) + 2);
        for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
          const std::uint8_t* above = found.row(std::max(v - 1, 0));
          const std::uint8_t* own = found.row(v);
          const std::uint8_t* below = found.row(std::min(v + 1, height - 1));
          for (int u = 0; u < width; ++u) {
            column[static_cast<std::size_t>(u) + 1] =
                static_cast<std::uint8_t>(above[u] | own[u] | below[u]);
          }
          std::uint8_t* to = mask.row(v);
          for (std::size_t u = 0; u < static_cast<std::size_t>(width); ++u) {
            to[u] = static_cast<std::uint8_t>(column[u] | column[u + 1] | column[u + 2]);
          }
        }
      });
}

void HighlightFiller::fill(const Plane<std::uint8_t>& mask, Plane<float>& picture) {
  std::size_t used = 0;
  // Pull: halves until no pixel is without unmarked ones, or one is left.
  int width = picture.width;
  int height = picture.height;
  bool whole = false;
  while (!whole && (width > 1 || height > 1)) {
    const int half_width = (width + 1) / 2;
    const int half_height = (height + 1) / 2;
    if (levels_.size() == used) levels_.emplace_back();
    Level& level = levels_[used];
    if (!level.mean.same_size(half_width, half_height)) {
      level = {Plane<float>(half_width, half_height), Plane<float>(half_width, half_height)};
    }
    const Level* finer = used == 0 ? nullptr : &levels_[used - 1];
    parallel_for_chunks(static_cast<std::size_t>(half_height), kRowsPerChunk,
                        [&](std::size_t begin, std::size_t end) {
                          for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
                            for (int u = 0; u < half_width; ++u) {
                              float sum = 0;
                              float weights = 0;
                              for (int k = 0; k < 4; ++k) {
                                const int row = std::min(2 * v + k / 2, height - 1);
                                const int column = std::min(2 * u + k % 2, width - 1);
                                const float weight =
                                    finer != nullptr ? finer->weight.at(column, row)
                                                     : (mask.at(column, row) != 0 ? 0.0F : 1.0F);
                                sum += weight * (finer != nullptr ? finer->mean.at(column, row)
                                                                  : picture.at(column, row));
                                weights += weight;
                              }
                              level.mean.at(u, v) = weights > 0 ? sum / weights : 0;
                              level.weight.at(u, v) = weights / 4;
                            }
                          }
                        });
    whole = std::all_of(level.weight.values.begin(), level.weight.values.end(),
                        [](float weight) { return weight > 0; });
    width = half_width;
    height = half_height;
    ++used;
  }
  if (!whole) return;
  // Push: what a pixel lacks comes from the coarser one, interpolated between centres.
  const auto interpolate = [](const Plane<float>& coarse, int u, int v) {
    constexpr float kNear = 0.75F;
    constexpr float kFar = 0.25F;
    const int near_u = u / 2;
    const int near_v = v / 2;
    const int far_u = std::clamp(u % 2 == 0 ? near_u - 1 : near_u + 1, 0, coarse.width - 1);
    const int far_v = std::clamp(v % 2 == 0 ? near_v - 1 : near_v + 1, 0, coarse.height - 1);
    return kNear * (kNear * coarse.at(near_u, near_v) + kFar * coarse.at(far_u, near_v)) +
           kFar * (kNear * coarse.at(near_u, far_v) + kFar * coarse.at(far_u, far_v));
  };
  for (std::size_t i = used - 1; i-- > 0;) {
    Level& level = levels_[i];
    for (int v = 0; v < level.mean.height; ++v) {
      for (int u = 0; u < level.mean.width; ++u) {
        const float weight = level.weight.at(u, v);
        if (weight == 1) continue;
        level.mean.at(u, v) =
            weight * level.mean.at(u, v) + (1 - weight) * interpolate(levels_[i + 1].mean, u, v);
      }
    }
  }
  for (int v = 0; v < picture.height; ++v) {
    const std::uint8_t* marked = mask.row(v);
    float* row = picture.row(v);
    for (int u = 0; u < picture.width; ++u) {
      if (marked[u] != 0) row[u] = interpolate(levels_[0].mean, u, v);
    }
  }
}

}  // namespace gastronaut::perception

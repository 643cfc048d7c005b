#include "depth_estimator/highlights.hpp"

#include <algorithm>
#include <cmath>

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
// And over its spread there, because where light meets shadow the lit side is no reflection; unless
// it is brighter than pale tissue between darker gets in real capsules' pictures.
constexpr float kBrighterBySigmas = 2;
constexpr float kBrighterThanTissue = 190;
constexpr float kNever = 256;  // more than any level
// Blue over red, and over green where red is saturated, likewise. Tissue is red; what a film of
// mucus mirrors is as white as the lamp.
constexpr float kWhiterThanRed = 1.15F;
constexpr float kWhiterThanGreen = 1.05F;
constexpr std::size_t kRowsPerChunk = 16;

// Sums over the lit and unsaturated pixels of a block of the picture.
struct Colour {
  float red = 0;
  float green = 0;
  float blue = 0;
  float blue_squared = 0;
  float count = 0;

  void add(const Colour& other) {
    red += other.red;
    green += other.green;
    blue += other.blue;
    blue_squared += other.blue_squared;
    count += other.count;
  }
};

// What a pixel's blue must exceed to be a reflection.
struct Threshold {
  float blue = kNever;
  float over_red = kNever;    // times the pixel's red
  float over_green = kNever;  // times its green; counts where red is saturated
};

Threshold threshold_within(const Colour& around) {
  if (around.count == 0 || around.blue == 0) return {};
  const float mean = around.blue / around.count;
  const float variance = std::max(0.0F, around.blue_squared / around.count - mean * mean);
  const float lit = std::min(kBrighterThanTissue, mean + kBrighterBySigmas * std::sqrt(variance));
  return {std::max({kFaintest, kBrighterByFactor * mean + kBrighterByLevels, lit}),
          kWhiterThanRed * around.blue / around.red, kWhiterThanGreen * around.blue / around.green};
}

// One a block, from it and its eight neighbours.
Plane<Threshold> block_thresholds(const std::uint8_t* rgb, int width, int height) {
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
        int blue_squared = 0;
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
          blue_squared += counts * pixel[2] * pixel[2];
          count += counts;
        }
        sums.at(i, j).add({static_cast<float>(red), static_cast<float>(green),
                           static_cast<float>(blue), static_cast<float>(blue_squared),
                           static_cast<float>(count)});
      }
    }
  });
  Plane<Threshold> thresholds(columns, rows);
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      Colour around;
      for (int b = std::max(0, j - 1); b <= std::min(rows - 1, j + 1); ++b) {
        for (int a = std::max(0, i - 1); a <= std::min(columns - 1, i + 1); ++a) {
          around.add(sums.at(a, b));
        }
      }
      thresholds.at(i, j) = threshold_within(around);
    }
  }
  return thresholds;
}

Threshold between(const Threshold& a, const Threshold& b, float along) {
  return {a.blue + along * (b.blue - a.blue), a.over_red + along * (b.over_red - a.over_red),
          a.over_green + along * (b.over_green - a.over_green)};
}

// Between block centres: a threshold that jumped from block to block would draw their outlines.
void mark_row(const std::uint8_t* rgb, int width, int v, const Plane<Threshold>& thresholds,
              std::vector<Threshold>& of_row, std::uint8_t* to) {
  const auto place = static_cast<float>(v - kBlock / 2) / kBlock;
  const int above = std::clamp(static_cast<int>(std::floor(place)), 0, thresholds.height - 1);
  const int below = std::min(above + 1, thresholds.height - 1);
  const float down = std::clamp(place - static_cast<float>(above), 0.0F, 1.0F);
  of_row.resize(static_cast<std::size_t>(thresholds.width));
  for (int i = 0; i < thresholds.width; ++i) {
    of_row[static_cast<std::size_t>(i)] =
        between(thresholds.at(i, above), thresholds.at(i, below), down);
  }
  for (int i = -1; i < thresholds.width; ++i) {
    const Threshold& left = of_row[static_cast<std::size_t>(std::max(i, 0))];
    const Threshold& right =
        of_row[static_cast<std::size_t>(std::min(i + 1, thresholds.width - 1))];
    const int centre = i * kBlock + kBlock / 2;
    for (int u = std::max(centre, 0); u < std::min(centre + kBlock, width); ++u) {
      const Threshold least = between(left, right, static_cast<float>(u - centre) / kBlock);
      const std::uint8_t* pixel = rgb + 3 * u;
      const auto red = static_cast<float>(pixel[0]);
      const auto green = static_cast<float>(pixel[1]);
      const auto blue = static_cast<float>(pixel[2]);
      const float least_white =
          pixel[0] < kSaturated ? least.over_red * red : least.over_green * green;
      const bool certain = std::min({pixel[0], pixel[1], pixel[2]}) >= kCertain;
      to[u] = static_cast<std::uint8_t>(certain | ((blue > least_white) & (blue > least.blue)));
    }
  }
}

}  // namespace

void find_highlights(const std::uint8_t* rgb, int width, int height, Plane<std::uint8_t>& mask) {
  const Plane<Threshold> thresholds = block_thresholds(rgb, width, height);
  Plane<std::uint8_t> found(width, height);
  parallel_for_chunks(static_cast<std::size_t>(height), kRowsPerChunk,
                      [&](std::size_t begin, std::size_t end) {
                        std::vector<Threshold> of_row;
                        for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
                          mark_row(rgb + 3 * static_cast<std::ptrdiff_t>(v) * width, width, v,
                                   thresholds, of_row, found.row(v));
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

#include "depth_estimator/highlights.hpp"

#include <algorithm>

#include "numerics/parallel.hpp"

namespace gastronaut::perception {
namespace {

constexpr int kBlock = 16;  // pixels: surroundings are 3 x 3 blocks
constexpr int kCertain = 245;
// Beyond these, a pixel is brighter than tissue's own patterns make it. Levels of 0 to 255.
constexpr float kBrighterByFactor = 1.3F;
constexpr float kBrighterByLevels = 12;
constexpr int kDarkestHighlight = 90;
constexpr std::size_t kRowsPerChunk = 16;

// Mean of whiteness over each block and its eight neighbours.
Plane<float> surroundings(const Plane<std::uint8_t>& whiteness) {
  const int columns = (whiteness.width + kBlock - 1) / kBlock;
  const int rows = (whiteness.height + kBlock - 1) / kBlock;
  Plane<int> sums(columns, rows);
  Plane<int> counts(columns, rows);
  parallel_for_chunks(static_cast<std::size_t>(rows), 1, [&](std::size_t begin, std::size_t) {
    const int j = static_cast<int>(begin);
    for (int v = j * kBlock; v < std::min((j + 1) * kBlock, whiteness.height); ++v) {
      const std::uint8_t* row = whiteness.row(v);
      for (int i = 0; i < columns; ++i) {
        const int end = std::min((i + 1) * kBlock, whiteness.width);
        int sum = 0;
        for (int u = i * kBlock; u < end; ++u) sum += row[u];
        sums.at(i, j) += sum;
        counts.at(i, j) += end - i * kBlock;
      }
    }
  });
  Plane<float> means(columns, rows);
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      int sum = 0;
      int count = 0;
      for (int b = std::max(0, j - 1); b <= std::min(rows - 1, j + 1); ++b) {
        for (int a = std::max(0, i - 1); a <= std::min(columns - 1, i + 1); ++a) {
          sum += sums.at(a, b);
          count += counts.at(a, b);
        }
      }
      means.at(i, j) = static_cast<float>(sum) / static_cast<float>(count);
    }
  }
  return means;
}

}  // namespace

void find_highlights(const Plane<std::uint8_t>& whiteness, Plane<std::uint8_t>& mask) {
  const int width = whiteness.width;
  const int height = whiteness.height;
  const Plane<float> means = surroundings(whiteness);
  Plane<std::uint8_t> found(width, height);
  parallel_for_chunks(
      static_cast<std::size_t>(height), kRowsPerChunk, [&](std::size_t begin, std::size_t end) {
        for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
          const std::uint8_t* white = whiteness.row(v);
          std::uint8_t* to = found.row(v);
          for (int i = 0; i * kBlock < width; ++i) {
            const float mean = means.at(i, v / kBlock);
            const float least = kBrighterByFactor * mean + kBrighterByLevels;
            const int threshold =
                std::min(kCertain, std::max(kDarkestHighlight, static_cast<int>(least)));
            for (int u = i * kBlock; u < std::min((i + 1) * kBlock, width); ++u) {
              to[u] = white[u] > threshold ? 1 : 0;
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

#include "visual_slam/tracking_pyramid.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <initializer_list>
#include <limits>
#include <vector>

#include "numerics/parallel.hpp"
#include "visual_slam/tracking_kernels.hpp"

namespace gastronaut::slam {
namespace {

constexpr float kNone = std::numeric_limits<float>::quiet_NaN();
constexpr std::size_t kRowsAtOnce = 8;

template <class Body>
void for_rows(int height, const Body& body) {
  parallel_for_chunks(static_cast<std::size_t>(height), kRowsAtOnce,
                      [&](std::size_t begin, std::size_t end) {
                        body(static_cast<int>(begin), static_cast<int>(end));
                      });
}

Plane<float> padded_plane(const PinholeGrid& grid) {
  const int width = (grid.width + kTrackingLanes - 1) / kTrackingLanes * kTrackingLanes;
  return Plane<float>(width, grid.height, kNone);
}

FrameLevel frame_level(const PinholeGrid& finest, int pixel) {
  const PinholeGrid grid = finest.coarser(pixel);
  const Plane<float> empty = padded_plane(grid);
  return {grid, empty, empty, empty, static_cast<double>(pixel)};
}

// Copies a picture, its marks for "nothing there" replaced by NaN.
template <class Valid>
void take(const Plane<float>& from, const Valid& valid, Plane<float>& to) {
  for_rows(from.height, [&](int begin, int end) {
    for (int v = begin; v < end; ++v) {
      const float* source = from.row(v);
      float* target = to.row(v);
      for (int u = 0; u < from.width; ++u) target[u] = valid(source[u]) ? source[u] : kNone;
    }
  });
}

struct Followed {
  const Plane<float>* fine;
  Plane<float>* coarse;
};

// Means of what lies on the nearest surface of each block of two by two pixels; the planes that
// follow are treated as the depth is.
void halve_surface(const FrameLevel& fine, double jump, FrameLevel& coarse,
                   std::initializer_list<Followed> followers) {
  // Neighbours on a slope are further apart where pixels are larger.
  const auto reach = static_cast<float>(1 + jump * fine.pixel);
  for_rows(coarse.grid.height, [&](int begin, int end) {
    for (int v = begin; v < end; ++v) {
      for (int u = 0; u < coarse.grid.width; ++u) {
        const float* rows[2] = {fine.depth.row(2 * v) + 2 * u, fine.depth.row(2 * v + 1) + 2 * u};
        float nearest = std::numeric_limits<float>::infinity();
        for (const float* row : rows) {
          for (int i = 0; i < 2; ++i) nearest = row[i] < nearest ? row[i] : nearest;
        }
        const auto mean = [&](const Plane<float>& plane) {
          float total = 0;
          float count = 0;
          for (int j = 0; j < 2; ++j) {
            const float* values = plane.row(2 * v + j) + 2 * u;
            for (int i = 0; i < 2; ++i) {
              if (rows[j][i] > nearest * reach || !(values[i] == values[i])) continue;
              if (!(rows[j][i] == rows[j][i])) continue;
              total += values[i];
              count += 1;
            }
          }
          return count > 0 ? total / count : kNone;
        };
        coarse.depth.at(u, v) = mean(fine.depth);
        for (const Followed& follower : followers) {
          follower.coarse->at(u, v) = mean(*follower.fine);
        }
      }
    }
  });
}

// Binomial (1 3 3 1) in both directions, centred on each block of two by two pixels; what is
// masked is left out, and more than half of the weight must be there.
void halve_albedo(const Plane<float>& fine, int fine_width, FrameLevel& coarse) {
  constexpr float kTaps[4] = {1, 3, 3, 1};
  constexpr float kHalf = 32;  // of the taps' sum of 64
  for_rows(coarse.grid.height, [&](int begin, int end) {
    std::vector<float> value(static_cast<std::size_t>(fine_width) + 2);
    std::vector<float> weight(value.size());
    for (int v = begin; v < end; ++v) {
      std::fill(value.begin(), value.end(), 0.0F);
      std::fill(weight.begin(), weight.end(), 0.0F);
      for (int j = 0; j < 4; ++j) {
        const int line = 2 * v - 1 + j;
        if (line < 0 || line >= fine.height) continue;
        const float* row = fine.row(line);
        for (int u = 0; u < fine_width; ++u) {
          const auto at = static_cast<std::size_t>(u) + 1;
          const bool seen = row[u] == row[u];
          value[at] += seen ? kTaps[j] * row[u] : 0;
          weight[at] += seen ? kTaps[j] : 0;
        }
      }
      for (int u = 0; u < coarse.grid.width; ++u) {
        float total = 0;
        float share = 0;
        for (std::size_t i = 0; i < 4; ++i) {
          const std::size_t at = static_cast<std::size_t>(2 * u) + i;
          total += kTaps[i] * value[at];
          share += kTaps[i] * weight[at];
        }
        coarse.raw_albedo.at(u, v) = share > kHalf ? total / share : kNone;
      }
    }
  });
}

// Second differences along rows hold the noise six times; most of them hold little else.
double roughness(const FrameLevel& level) {
  constexpr int kEveryRow = 4;
  constexpr double kGaussianMedian = 0.6745;  // of a normal deviate's size
  std::vector<float> differences;
  differences.reserve(level.depth.size() / kEveryRow);
  for (int v = 0; v < level.grid.height; v += kEveryRow) {
    const float* row = level.depth.row(v);
    for (int u = 1; u + 1 < level.grid.width; ++u) {
      const float bend = std::fabs(row[u - 1] - 2 * row[u] + row[u + 1]) / row[u];
      if (bend == bend) differences.push_back(bend);
    }
  }
  if (differences.empty()) return 0;
  const auto middle = differences.begin() + static_cast<std::ptrdiff_t>(differences.size() / 2);
  std::nth_element(differences.begin(), middle, differences.end());
  return static_cast<double>(*middle) / (kGaussianMedian * std::sqrt(6.0));
}

void normalise(const PyramidOptions& options, FrameLevel& level) {
  for_rows(level.grid.height, [&](int begin, int end) {
    normalise_contrast(level, static_cast<float>(options.contrast_floor), begin, end);
  });
}

void differentiate(ModelLevel& level) {
  const int height = level.grid.height;
  const int width = level.grid.width;
  for_rows(height, [&](int begin, int end) {
    for (int v = std::max(begin, 1); v < std::min(end, height - 1); ++v) {
      const float* row = level.albedo.row(v);
      const float* above = level.albedo.row(v - 1);
      const float* below = level.albedo.row(v + 1);
      float* gradient_x = level.gradient_x.row(v);
      float* gradient_y = level.gradient_y.row(v);
      for (int u = 1; u < width - 1; ++u) {
        gradient_x[u] = (row[u + 1] - row[u - 1]) / 2;
        gradient_y[u] = (below[u] - above[u]) / 2;
      }
    }
  });
}

bool is_depth(float depth) { return depth > 0 && std::isfinite(depth); }
bool is_albedo(float albedo) { return albedo >= 0 && std::isfinite(albedo); }

}  // namespace

FramePyramid frame_pyramid(const PinholeGrid& grid) {
  FramePyramid pyramid;
  for (std::size_t l = 0; l < pyramid.size(); ++l) pyramid[l] = frame_level(grid, 1 << l);
  return pyramid;
}

ModelPyramid model_pyramid(const PinholeGrid& grid) {
  ModelPyramid pyramid;
  for (std::size_t l = 0; l < pyramid.size(); ++l) {
    const FrameLevel level = frame_level(grid, 1 << l);
    const Plane<float>& empty = level.depth;
    pyramid[l] = {level, empty, empty, empty, empty, empty};
  }
  return pyramid;
}

void fill(const Frame& frame, const PyramidOptions& options, FramePyramid& pyramid) {
  take(frame.depth, is_depth, pyramid[0].depth);
  take(frame.albedo, is_albedo, pyramid[0].raw_albedo);
  for (std::size_t l = 0; l < pyramid.size(); ++l) {
    FrameLevel& level = pyramid[l];
    if (l > 0) {
      const FrameLevel& fine = pyramid[l - 1];
      halve_surface(fine, options.jump, level, {});
      halve_albedo(fine.raw_albedo, fine.grid.width, level);
    }
    level.roughness = roughness(level);
    normalise(options, level);
  }
}

void fill(const ModelView& model, const PyramidOptions& options, ModelPyramid& pyramid) {
  const auto any = [](float) { return true; };
  take(model.depth, is_depth, pyramid[0].depth);
  take(model.albedo, is_albedo, pyramid[0].raw_albedo);
  take(model.normal_x, any, pyramid[0].normal_x);
  take(model.normal_y, any, pyramid[0].normal_y);
  take(model.normal_z, any, pyramid[0].normal_z);
  for (std::size_t l = 0; l < pyramid.size(); ++l) {
    ModelLevel& level = pyramid[l];
    if (l > 0) {
      const ModelLevel& fine = pyramid[l - 1];
      halve_surface(fine, options.jump, level,
                    {{&fine.normal_x, &level.normal_x},
                     {&fine.normal_y, &level.normal_y},
                     {&fine.normal_z, &level.normal_z}});
      halve_albedo(fine.raw_albedo, fine.grid.width, level);
    }
    level.roughness = roughness(level);
    normalise(options, level);
    differentiate(level);
  }
}

}  // namespace gastronaut::slam

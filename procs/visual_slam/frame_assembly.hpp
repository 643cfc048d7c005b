// From the pictures that arrive to one frame: depth and albedo on one grid, fine enough to track
// with and coarse enough for the budget.
#pragma once

#include <cstdint>
#include <stdexcept>
#include <vector>

#include "camera/pinhole_grid.hpp"
#include "visual_slam/frame.hpp"

namespace gastronaut::slam {

struct DepthCounts {
  PinholeGrid grid;
  std::vector<std::uint16_t> counts;  // row by row; 0: none
  double metres_per_count = 0;
  double relative_std = 1;
};

struct AlbedoLevels {
  PinholeGrid grid;
  std::vector<std::uint8_t> levels;  // row by row, 255: albedo 1; 0: none
};

// The frame's grid is depth's over the smallest whole number that makes it no wider than max_width;
// albedo's must be a whole number of times as fine as it, else std::invalid_argument. A block's
// depth is the middle one of those that it has, if half have one; its albedo the mean.
Frame assemble_frame(std::int64_t utime, const DepthCounts& depth, const AlbedoLevels& albedo,
                     int max_width);

}  // namespace gastronaut::slam

// Mirror reflections of the lamps on wet tissue: found, and filled from what is around them.
#pragma once

#include <cstdint>
#include <vector>

#include "image/plane.hpp"

namespace gastronaut::perception {

// Marks in `mask` (1; else 0) the pixels of `rgb` (width * height * 3 levels, row by row) that are
// clearly brighter and whiter than the lit tissue around them, and those beside them. Tissue that
// is only nearer keeps its colour.
void find_highlights(const std::uint8_t* rgb, int width, int height, Plane<std::uint8_t>& mask);

// Replaces the marked pixels by what the nearest unmarked ones, at ever coarser scales, average to.
// Without unmarked pixels nothing changes.
class HighlightFiller {
 public:
  void fill(const Plane<std::uint8_t>& mask, Plane<float>& picture);

 private:
  struct Level {
    Plane<float> mean;
    Plane<float> weight;  // share of unmarked pixels, 0 to 1
  };
  std::vector<Level> levels_;  // each half the size of the one before; [0]: half the picture
};

}  // namespace gastronaut::perception

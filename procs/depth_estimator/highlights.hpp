// Mirror reflections of the lamps on wet tissue: found, and filled from what is around them.
#pragma once

#include <cstdint>
#include <vector>

#include "image/plane.hpp"

namespace gastronaut::perception {

// Marks in `mask` (1; else 0) the pixels of a picture that are near white and clearly brighter than
// their surroundings, and those beside them. `whiteness`: the smallest of a pixel's three channels,
// 0 to 255: tissue is red, its reflections are white.
void find_highlights(const Plane<std::uint8_t>& whiteness, Plane<std::uint8_t>& mask);

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

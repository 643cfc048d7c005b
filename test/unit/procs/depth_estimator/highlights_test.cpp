#include "depth_estimator/highlights.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace gastronaut::perception {
namespace {

constexpr int kWidth = 160;
constexpr int kHeight = 120;

// Tissue, brighter from left to right, of one colour.
std::vector<std::uint8_t> tissue() {
  std::vector<std::uint8_t> rgb;
  for (int v = 0; v < kHeight; ++v) {
    for (int u = 0; u < kWidth; ++u) {
      const double light = 0.4 + 0.6 * u / kWidth;
      for (const double level : {200.0, 130.0, 110.0}) {
        rgb.push_back(static_cast<std::uint8_t>(light * level));
      }
    }
  }
  return rgb;
}

void add_white(std::vector<std::uint8_t>& rgb, int centre_u, int centre_v, int radius, int level) {
  for (int v = centre_v - radius; v <= centre_v + radius; ++v) {
    for (int u = centre_u - radius; u <= centre_u + radius; ++u) {
      if (std::hypot(u - centre_u, v - centre_v) > radius) continue;
      for (int c = 0; c < 3; ++c) {
        std::uint8_t& value = rgb[static_cast<std::size_t>(3 * (v * kWidth + u) + c)];
        value = static_cast<std::uint8_t>(std::min(255, value + level));
      }
    }
  }
}

int count(const Plane<std::uint8_t>& mask) {
  return static_cast<int>(std::count(mask.values.begin(), mask.values.end(), 1));
}

TEST(Highlights, TissueHasNoneHoweverUnevenItsLight) {
  Plane<std::uint8_t> mask;
  find_highlights(tissue().data(), kWidth, kHeight, mask);
  EXPECT_EQ(count(mask), 0);
}

TEST(Highlights, ReflectionIsMarkedWithItsRimAndNothingElse) {
  std::vector<std::uint8_t> rgb = tissue();
  constexpr int kRadius = 4;
  add_white(rgb, 60, 50, kRadius, 80);
  Plane<std::uint8_t> mask;
  find_highlights(rgb.data(), kWidth, kHeight, mask);
  for (int v = 0; v < kHeight; ++v) {
    for (int u = 0; u < kWidth; ++u) {
      const double distance = std::hypot(u - 60, v - 50);
      if (distance <= kRadius) {
        EXPECT_EQ(mask.at(u, v), 1) << u << ", " << v;
      } else if (distance > kRadius + std::sqrt(2.0)) {
        EXPECT_EQ(mask.at(u, v), 0) << u << ", " << v;
      }
    }
  }
}

TEST(Highlights, BrightFoldOfTissueIsNone) {
  std::vector<std::uint8_t> rgb = tissue();
  for (int v = 40; v < 48; ++v) {
    for (int u = 20; u < 140; ++u) {
      for (int c = 0; c < 3; ++c) {
        std::uint8_t& value = rgb[static_cast<std::size_t>(3 * (v * kWidth + u) + c)];
        value = static_cast<std::uint8_t>(std::min(255.0, 1.5 * value));
      }
    }
  }
  Plane<std::uint8_t> mask;
  find_highlights(rgb.data(), kWidth, kHeight, mask);
  EXPECT_EQ(count(mask), 0);
}

// Seen in real capsules' pictures: a pale fold rises out of blood. Both whiter and brighter than
// what is around it, and still tissue.
TEST(Highlights, PaleTissueBesideDarkIsNone) {
  std::vector<std::uint8_t> rgb;
  for (int v = 0; v < kHeight; ++v) {
    for (int u = 0; u < kWidth; ++u) {
      const bool pale = v >= 40 && v < 70;
      for (const int level : pale ? std::array{210, 170, 140} : std::array{120, 40, 30}) {
        rgb.push_back(static_cast<std::uint8_t>(level));
      }
    }
  }
  Plane<std::uint8_t> mask;
  find_highlights(rgb.data(), kWidth, kHeight, mask);
  EXPECT_EQ(count(mask), 0);
}

TEST(Highlights, WhitePictureIsAllHighlightBlackPictureNone) {
  Plane<std::uint8_t> mask;
  find_highlights(std::vector<std::uint8_t>(3 * 20 * 10, 255).data(), 20, 10, mask);
  EXPECT_EQ(count(mask), 200);
  find_highlights(std::vector<std::uint8_t>(3 * 20 * 10, 0).data(), 20, 10, mask);
  EXPECT_EQ(count(mask), 0);
}

Plane<float> slope() {
  Plane<float> picture(kWidth, kHeight);
  for (int v = 0; v < kHeight; ++v) {
    for (int u = 0; u < kWidth; ++u) {
      picture.at(u, v) = 0.3F + 0.002F * static_cast<float>(u) + 0.001F * static_cast<float>(v);
    }
  }
  return picture;
}

TEST(HighlightFiller, HoleIsFilledFromItsSurroundings) {
  Plane<float> picture = slope();
  const Plane<float> whole = picture;
  Plane<std::uint8_t> mask(kWidth, kHeight);
  constexpr int kSide = 9;
  for (int v = 60; v < 60 + kSide; ++v) {
    for (int u = 80; u < 80 + kSide; ++u) {
      mask.at(u, v) = 1;
      picture.at(u, v) = 1;
    }
  }
  HighlightFiller().fill(mask, picture);
  // What the slope changes by over the hole bounds what its surroundings can differ by.
  constexpr float kAcrossTheHole = 0.003F * kSide;
  for (int v = 0; v < kHeight; ++v) {
    for (int u = 0; u < kWidth; ++u) {
      if (mask.at(u, v) == 0) {
        EXPECT_EQ(picture.at(u, v), whole.at(u, v));
      } else {
        EXPECT_NEAR(picture.at(u, v), whole.at(u, v), kAcrossTheHole) << u << ", " << v;
      }
    }
  }
}

TEST(HighlightFiller, NothingToFillFromLeavesThePictureAlone) {
  for (const auto& [width, height] : {std::pair{1, 1}, {5, 3}}) {
    Plane<float> picture(width, height, 0.5F);
    HighlightFiller().fill(Plane<std::uint8_t>(width, height, 1), picture);
    EXPECT_EQ(picture.values, Plane<float>(width, height, 0.5F).values);
  }
}

TEST(HighlightFiller, ServesPicturesOfSeveralSizesInTurn) {
  HighlightFiller filler;
  for (const auto& [width, height] : {std::pair{64, 48}, {31, 17}, {64, 48}}) {
    Plane<float> picture(width, height, 0.5F);
    Plane<std::uint8_t> mask(width, height);
    mask.at(3, 4) = 1;
    picture.at(3, 4) = 1;
    filler.fill(mask, picture);
    EXPECT_FLOAT_EQ(picture.at(3, 4), 0.5F);
  }
}

}  // namespace
}  // namespace gastronaut::perception

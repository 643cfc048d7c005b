#include "visual_slam/tracking_pyramid.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace gastronaut::slam {
namespace {

const PinholeGrid kGrid{64, 48, 40, 40, 31.5, 23.5};
constexpr float kNear = 0.02F;  // metres
constexpr float kFar = 0.04F;

Frame step_frame() {
  Frame frame{0, kGrid, Plane<float>(kGrid.width, kGrid.height),
              Plane<float>(kGrid.width, kGrid.height)};
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      frame.depth.at(u, v) = u < 31 ? kNear : kFar;  // the step is inside a block
      frame.albedo.at(u, v) = static_cast<float>(0.5 + 0.2 * std::sin(0.9 * u) * std::cos(0.7 * v));
    }
  }
  return frame;
}

TEST(TrackingPyramid, CoarseDepthDoesNotMixSurfaces) {
  Frame frame = step_frame();
  frame.depth.at(2, 2) = std::numeric_limits<float>::quiet_NaN();
  FramePyramid pyramid = frame_pyramid(kGrid);
  fill(frame, {}, pyramid);
  for (const FrameLevel& level : pyramid) {
    for (int v = 0; v < level.grid.height; ++v) {
      for (int u = 0; u < level.grid.width; ++u) {
        const float depth = level.depth.at(u, v);
        EXPECT_TRUE(std::isnan(depth) || depth == kNear || depth == kFar) << depth;
      }
    }
  }
  // One pixel without depth leaves the others of its block.
  EXPECT_TRUE(std::isnan(pyramid[0].depth.at(2, 2)));
  EXPECT_EQ(pyramid[1].depth.at(1, 1), kNear);
}

TEST(TrackingPyramid, ContrastDoesNotDependOnTheLightsStrength) {
  constexpr float kSinglePrecision = 1e-3F;  // of differences of squares, over the deviation
  Frame frame = step_frame();
  FramePyramid bright = frame_pyramid(kGrid);
  fill(frame, {}, bright);
  for (float& albedo : frame.albedo.values) albedo *= 0.3F;
  FramePyramid dim = frame_pyramid(kGrid);
  fill(frame, {}, dim);
  int compared = 0;
  for (int v = 0; v < kGrid.height; ++v) {
    for (int u = 0; u < kGrid.width; ++u) {
      const float expected = bright[0].albedo.at(u, v);
      if (!(expected == expected)) continue;
      EXPECT_NEAR(dim[0].albedo.at(u, v), expected, kSinglePrecision);
      ++compared;
    }
  }
  EXPECT_GT(compared, kGrid.width * kGrid.height / 3);  // the border's windows are cut
}

TEST(TrackingPyramid, MaskedPixelsDoNotChangeTheirSurroundings) {
  // A highlight of nine pixels in a window of 17 x 17, as bright as ten times the tissue, would
  // change the local deviation many times over; leaving it out changes it little.
  constexpr float kLittle = 0.1F;
  Frame frame = step_frame();
  FramePyramid clean = frame_pyramid(kGrid);
  fill(frame, {}, clean);
  for (int v = 23; v < 26; ++v) {
    for (int u = 31; u < 34; ++u) frame.albedo.at(u, v) = -1;
  }
  FramePyramid masked = frame_pyramid(kGrid);
  fill(frame, {}, masked);
  EXPECT_TRUE(std::isnan(masked[0].albedo.at(32, 24)));
  for (int u = 26; u < 31; ++u) {
    EXPECT_NEAR(masked[0].albedo.at(u, 24), clean[0].albedo.at(u, 24), kLittle);
  }
}

}  // namespace
}  // namespace gastronaut::slam

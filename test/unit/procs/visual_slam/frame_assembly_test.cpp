#include "visual_slam/frame_assembly.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <functional>
#include <stdexcept>
#include <vector>

#include "numerics/parallel.hpp"

namespace gastronaut::slam {
namespace {

constexpr double kMetresPerCount = 1e-5;
constexpr std::int64_t kUtime = 17;
// Depths and albedos are floats.
constexpr double kRounding = 1e-6;
const PinholeGrid kGrid = {32, 24, 20, 20, 15.5, 11.5};

DepthCounts depth_of(const PinholeGrid& grid, const std::function<int(int, int)>& count) {
  DepthCounts depth{grid, {}, kMetresPerCount, 0.03};
  for (int v = 0; v < grid.height; ++v) {
    for (int u = 0; u < grid.width; ++u) {
      depth.counts.push_back(static_cast<std::uint16_t>(count(u, v)));
    }
  }
  return depth;
}

AlbedoLevels albedo_of(const PinholeGrid& grid, const std::function<int(int, int)>& level) {
  AlbedoLevels albedo{grid, {}};
  for (int v = 0; v < grid.height; ++v) {
    for (int u = 0; u < grid.width; ++u) {
      albedo.levels.push_back(static_cast<std::uint8_t>(level(u, v)));
    }
  }
  return albedo;
}

int grey(int, int) { return 128; }
int wall(int, int) { return 3000; }

TEST(FrameAssembly, SameGridIsTakenPixelByPixel) {
  const DepthCounts depth = depth_of(kGrid, [](int u, int v) { return 100 * v + u; });
  const AlbedoLevels albedo = albedo_of(kGrid, [](int u, int v) { return 5 * v + u; });
  const Frame frame = assemble_frame(kUtime, depth, albedo, kGrid.width);
  EXPECT_EQ(frame.utime, kUtime);
  EXPECT_TRUE(frame.grid == kGrid);
  EXPECT_EQ(frame.relative_std, depth.relative_std);
  EXPECT_NEAR(frame.depth.at(7, 3), 307 * kMetresPerCount, kRounding);
  EXPECT_NEAR(frame.albedo.at(7, 3), 22.0 / 255, kRounding);
  // Nothing known of the first pixel.
  EXPECT_EQ(frame.depth.at(0, 0), 0);
  EXPECT_LT(frame.albedo.at(0, 0), 0);
}

TEST(FrameAssembly, WideDepthIsHalvedUntilItFits) {
  for (const auto& [max_width, factor] : {std::pair{31, 2}, {16, 2}, {15, 3}, {8, 4}}) {
    const Frame frame =
        assemble_frame(kUtime, depth_of(kGrid, wall), albedo_of(kGrid, grey), max_width);
    EXPECT_TRUE(frame.grid == kGrid.coarser(factor)) << max_width;
    EXPECT_TRUE(frame.depth.same_size(frame.grid.width, frame.grid.height));
    EXPECT_TRUE(frame.albedo.same_size(frame.grid.width, frame.grid.height));
    for (const float metres : frame.depth.values) {
      EXPECT_NEAR(metres, 3000 * kMetresPerCount, kRounding);
    }
  }
}

TEST(FrameAssembly, NoPointsBetweenTwoSurfaces) {
  // An edge through the blocks' middle, three pixels of nine on the near side.
  const DepthCounts depth = depth_of(kGrid, [](int u, int) { return u % 3 == 0 ? 1000 : 4000; });
  const Frame frame = assemble_frame(kUtime, depth, albedo_of(kGrid, grey), 11);
  for (const float metres : frame.depth.values) {
    EXPECT_NEAR(metres, 4000 * kMetresPerCount, kRounding);
  }
  // Half and half: one of the two.
  const DepthCounts half = depth_of(kGrid, [](int u, int) { return u % 2 == 0 ? 1000 : 4000; });
  const Frame even = assemble_frame(kUtime, half, albedo_of(kGrid, grey), kGrid.width / 2);
  for (const float metres : even.depth.values) {
    EXPECT_NEAR(metres, 1000 * kMetresPerCount, kRounding);
  }
}

TEST(FrameAssembly, SlopeIsAveraged) {
  const DepthCounts depth = depth_of(kGrid, [](int u, int) { return 3000 + 10 * u; });
  const Frame frame = assemble_frame(kUtime, depth, albedo_of(kGrid, grey), kGrid.width / 2);
  for (int u = 0; u < frame.grid.width; ++u) {
    EXPECT_NEAR(frame.depth.at(u, 5), (3000 + 20 * u + 5) * kMetresPerCount, kRounding);
  }
}

TEST(FrameAssembly, HalfOfABlockMustBeKnown) {
  for (const int known : {0, 1, 2, 3, 4}) {
    const auto is_known = [known](int u, int v) { return 2 * (v % 2) + u % 2 < known; };
    const Frame frame = assemble_frame(
        kUtime, depth_of(kGrid, [&](int u, int v) { return is_known(u, v) ? 3000 : 0; }),
        albedo_of(kGrid, [&](int u, int v) { return is_known(u, v) ? 100 : 0; }), kGrid.width / 2);
    const bool enough = known >= 2;
    EXPECT_NEAR(frame.depth.at(3, 3), enough ? 3000 * kMetresPerCount : 0, kRounding) << known;
    EXPECT_NEAR(frame.albedo.at(3, 3), enough ? 100.0 / 255 : -1, kRounding) << known;
  }
}

TEST(FrameAssembly, AlbedoMayBeFinerThanDepth) {
  const PinholeGrid fine = {64, 48, 40, 40, 31.5, 23.5};
  const AlbedoLevels albedo =
      albedo_of(fine, [](int u, int v) { return 100 + 2 * (u % 2) + 4 * (v % 2); });
  const Frame frame = assemble_frame(kUtime, depth_of(kGrid, wall), albedo, kGrid.width);
  EXPECT_TRUE(frame.grid == kGrid);
  EXPECT_NEAR(frame.albedo.at(5, 6), 103.0 / 255, kRounding);
}

TEST(FrameAssembly, LargeBlocksAreNoTrouble) {
  const PinholeGrid large = {400, 300, 250, 250, 199.5, 149.5};
  const Frame frame = assemble_frame(kUtime, depth_of(large, wall), albedo_of(large, grey), 20);
  EXPECT_EQ(frame.grid.width, 20);
  EXPECT_NEAR(frame.depth.at(10, 7), 3000 * kMetresPerCount, kRounding);
}

TEST(FrameAssembly, PicturesThatDoNotGoTogetherAreRefused) {
  const DepthCounts depth = depth_of(kGrid, wall);
  const AlbedoLevels albedo = albedo_of(kGrid, grey);
  const auto refused = [&](const std::function<void(DepthCounts&, AlbedoLevels&, int&)>& spoil) {
    DepthCounts spoiled_depth = depth;
    AlbedoLevels spoiled_albedo = albedo;
    int max_width = kGrid.width;
    spoil(spoiled_depth, spoiled_albedo, max_width);
    EXPECT_THROW(assemble_frame(kUtime, spoiled_depth, spoiled_albedo, max_width),
                 std::invalid_argument);
  };
  refused([](auto& d, auto&, int&) { d.counts.pop_back(); });
  refused([](auto&, auto& a, int&) { a.levels.pop_back(); });
  refused([](auto& d, auto&, int&) { d = {}; });
  refused([](auto&, auto& a, int&) { a = {}; });
  refused([](auto& d, auto&, int&) { d.grid.width = -d.grid.width; });
  refused([](auto&, auto&, int& max_width) { max_width = 0; });
  refused([](auto& d, auto&, int&) { d.grid.fx *= 1.5; });
  refused([](auto& d, auto&, int&) { d.grid.fx = 1e-300; });
  refused([](auto& d, auto&, int&) { d.grid.fx = 1e300; });
  refused([](auto&, auto& a, int&) { a.grid.cy += 1; });
  refused([](auto& d, auto&, int&) { std::swap(d.grid.width, d.grid.height); });
}

TEST(FrameAssembly, SameBytesOnAnyNumberOfThreads) {
  const DepthCounts depth = depth_of(kGrid, [](int u, int v) { return u * v % 97 * 50; });
  const AlbedoLevels albedo = albedo_of(kGrid, [](int u, int v) { return u * v % 200; });
  set_thread_count(1);
  const Frame one = assemble_frame(kUtime, depth, albedo, kGrid.width / 2);
  set_thread_count(3);
  const Frame three = assemble_frame(kUtime, depth, albedo, kGrid.width / 2);
  set_thread_count(0);
  EXPECT_EQ(one.depth.values, three.depth.values);
  EXPECT_EQ(one.albedo.values, three.albedo.values);
}

}  // namespace
}  // namespace gastronaut::slam

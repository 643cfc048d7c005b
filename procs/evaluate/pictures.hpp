// Pictures for the report: decoded with suspicion, undistorted, and turned into what trackers
// compare.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "camera/camera_model.hpp"
#include "camera/pinhole_grid.hpp"
#include "evaluate/depth_errors.hpp"
#include "image/plane.hpp"

namespace gastronaut::evaluation {

using Levels = Plane<std::uint8_t>;
using ColourPicture = Plane<std::array<std::uint8_t, 3>>;  // blue, green, red

enum class PictureEncoding { kGray, kRgb, kBgr, kJpeg };

// `row_stride`: bytes from row to row of what is not JPEG, 0: rows follow each other. Nothing for
// data that are not such a picture of just that size, truncated JPEG included.
std::optional<ColourPicture> decode_colour(PictureEncoding encoding,
                                           std::span<const std::uint8_t> data, int width,
                                           int height, int row_stride);
std::optional<Levels> decode_levels(std::span<const std::uint8_t> data, int width, int height,
                                    int row_stride);

// The grid of width x height pixels that a k times coarser DEPTH was made from: pixel u of the
// coarse one covers pixels k u to k u + k - 1. Nothing where k is no whole number.
std::optional<PinholeGrid> finer_grid(const DepthPicture& coarse, int width, int height);

class Undistorter {
 public:
  Undistorter(const CameraIntrinsics& camera, const PinholeGrid& grid);

  const PinholeGrid& grid() const { return grid_; }
  // `picture` has the camera's size. Black where the lens does not see.
  ColourPicture undistort(const ColourPicture& picture) const;

 private:
  PinholeGrid grid_;
  Plane<float> columns_;  // where to look in the distorted picture
  Plane<float> rows_;
};

Levels luminance(const ColourPicture& picture);
// Contrast-limited adaptive histogram equalisation, clip limit 4, 8 x 8 tiles (Zuiderveld 1994).
Levels equalise_contrast(const Levels& picture);

}  // namespace gastronaut::evaluation

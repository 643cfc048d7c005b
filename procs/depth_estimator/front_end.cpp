#include "depth_estimator/front_end.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <opencv2/core/utility.hpp>
#include <opencv2/imgproc.hpp>

#include "camera/camera_model.hpp"
#include "numerics/parallel.hpp"
#include "photometry/camera_response.hpp"

namespace gastronaut::perception {
namespace {

constexpr int kRowsPerChunk = 16;
// Levels from here on count as saturated: JPEG rings by a few levels around what was clipped.
constexpr int kSaturatedLevel = 248;
constexpr int kSoftBorder = 4;  // pixels
constexpr int kDarkLevel = 10;  // all channels below: no light came back
// A picture that is dark, or saturated in all channels, in more of its pixels than this shows
// nothing.
constexpr double kAllButAll = 0.98;
// Tissue has a contrast of 0.05 to 0.16 on the virtual rig, the phantoms and real endoscopes; seen
// through turbid fluid, 0.01: noise.
constexpr double kLeastContrast = 0.025;

template <class Body>
void for_row_chunks(int height, const Body& body) {
  parallel_for_chunks(static_cast<std::size_t>(height), kRowsPerChunk,
                      [&](std::size_t begin, std::size_t end) {
                        body(static_cast<int>(begin), static_cast<int>(end));
                      });
}

// add_row(v, sum) for all rows, the sums of the chunks added up in order.
template <class Sum, class AddRow>
Sum sum_rows(int height, const Sum& zero, const AddRow& add_row) {
  return parallel_reduce_in_order(
      static_cast<std::size_t>(height), std::size_t{kRowsPerChunk}, zero,
      [&](std::size_t begin, std::size_t end) {
        Sum sum = zero;
        for (auto v = static_cast<int>(begin); v < static_cast<int>(end); ++v) add_row(v, sum);
        return sum;
      },
      [](Sum a, const Sum& b) { return a += b; });
}

constexpr int kAllSaturated = kRedSaturated | kGreenSaturated | kBlueSaturated;

struct PixelCounts {
  std::int64_t inside = 0;
  std::int64_t saturated = 0;  // in one channel at least
  std::int64_t white = 0;      // in all
  std::int64_t dark = 0;
  std::int64_t highlight = 0;
  std::int64_t green_levels = 0;  // their sum
  PixelCounts& operator+=(const PixelCounts& other) {
    inside += other.inside;
    saturated += other.saturated;
    white += other.white;
    dark += other.dark;
    highlight += other.highlight;
    green_levels += other.green_levels;
    return *this;
  }
};

// Energy of differences over 2 and over 8 pixels along one direction.
struct DifferenceEnergy {
  double fine = 0;
  double coarse = 0;
  int count = 0;
  DifferenceEnergy& operator+=(const DifferenceEnergy& other) {
    fine += other.fine;
    coarse += other.coarse;
    count += other.count;
    return *this;
  }
  double ratio() const { return coarse > 0 ? std::sqrt(fine / coarse) : 0; }
};

// Over pixels that show something. Every other row and column is enough for a mean. `step_u`,
// `step_v`: one pixel along.
DifferenceEnergy difference_energy(const Plane<float>& level, const Plane<std::uint8_t>& empty,
                                   int step_u, int step_v) {
  constexpr int kReach = 4;
  const auto add_row = [&](int v, DifferenceEnergy& energy) {
    for (int u = kReach * step_u; u < level.width - kReach * step_u; u += 2) {
      const auto is_empty = [&](int steps) {
        return empty.at(u + steps * step_u, v + steps * step_v);
      };
      if ((is_empty(-kReach) | is_empty(0) | is_empty(kReach)) != 0) continue;
      const auto difference = [&](int reach) {
        return static_cast<double>(level.at(u + reach * step_u, v + reach * step_v) -
                                   level.at(u - reach * step_u, v - reach * step_v));
      };
      energy.fine += difference(1) * difference(1);
      energy.coarse += difference(kReach) * difference(kReach);
      ++energy.count;
    }
  };
  return sum_rows(level.height, DifferenceEnergy(), [&](int v, DifferenceEnergy& energy) {
    const bool counts = v % 2 == 0 && v >= kReach * step_v && v < level.height - kReach * step_v;
    if (counts) add_row(v, energy);
  });
}

}  // namespace

FrontEnd::FrontEnd(const CameraConfiguration& camera)
    : width_(camera.width),
      height_(camera.height),
      decoder_(camera.width, camera.height),
      light_of_level_(linear_light_of_levels(camera)),
      outside_(camera.width, camera.height),
      empty_(camera.width, camera.height) {
  // Our own loops share out the rows (--threads); OpenCV's would start threads inside them.
  cv::setNumThreads(1);
  make_maps(camera);
}

void FrontEnd::make_maps(const CameraConfiguration& camera) {
  const CameraModel lens(camera.intrinsics());
  cv::Mat map_u(height_, width_, CV_32F);
  cv::Mat map_v(height_, width_, CV_32F);
  for (int v = 0; v < height_; ++v) {
    for (int u = 0; u < width_; ++u) {
      const auto pixel =
          lens.project({(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1});
      const bool inside = pixel && pixel->x() >= 0 && pixel->y() >= 0 && pixel->x() <= width_ - 1 &&
                          pixel->y() <= height_ - 1;
      outside_.at(u, v) = inside ? 0 : kOutside;
      map_u.at<float>(v, u) = inside ? static_cast<float>(pixel->x()) : 0;
      map_v.at<float>(v, u) = inside ? static_cast<float>(pixel->y()) : 0;
      constexpr double kNoShift = 1e-3;  // pixels
      if (!inside || std::hypot(pixel->x() - u, pixel->y() - v) > kNoShift) distorted_ = true;
    }
  }
  if (distorted_) cv::convertMaps(map_u, map_v, map_, map_fraction_, CV_16SC2);
}

PictureFailure FrontEnd::process(const EncodedPicture& encoded, LinearPicture& picture) {
  PictureFailure failure = decoder_.decode(encoded, decoded_);
  if (failure) return failure;
  undistort();
  develop(picture);
  return judge(picture);
}

// Levels are interpolated before they are made linear: between neighbours that differ by a tenth of
// full scale that is wrong by under half a per cent of it.
void FrontEnd::undistort() {
  if (!distorted_) {
    undistorted_.swap(decoded_);
    return;
  }
  undistorted_.resize(decoded_.size());
  const cv::Mat from(height_, width_, CV_8UC3, decoded_.data());
  cv::Mat to(height_, width_, CV_8UC3, undistorted_.data());
  for_row_chunks(height_, [&](int begin, int end) {
    cv::Mat rows = to.rowRange(begin, end);
    cv::remap(from, rows, map_.rowRange(begin, end), map_fraction_.rowRange(begin, end),
              cv::INTER_LINEAR, cv::BORDER_REPLICATE);
  });
}

void FrontEnd::develop(LinearPicture& picture) {
  if (!picture.flags.same_size(width_, height_)) {
    for (Plane<float>& light : picture.light) light = Plane<float>(width_, height_);
    picture.green_level = Plane<float>(width_, height_);
    picture.flags = Plane<std::uint8_t>(width_, height_);
  }
  find_highlights(undistorted_.data(), width_, height_, highlights_);
  for_row_chunks(height_, [&](int begin, int end) {
    for (int v = begin; v < end; ++v) {
      const std::uint8_t* rgb = undistorted_.data() + 3 * static_cast<std::ptrdiff_t>(v) * width_;
      const std::uint8_t* outside = outside_.row(v);
      const std::uint8_t* highlight = highlights_.row(v);
      float* red = picture.light[0].row(v);
      float* green = picture.light[1].row(v);
      float* blue = picture.light[2].row(v);
      float* level = picture.green_level.row(v);
      std::uint8_t* flags = picture.flags.row(v);
      std::uint8_t* empty = empty_.row(v);
      for (int u = 0; u < width_; ++u) {
        const std::uint8_t r = rgb[3 * u];
        const std::uint8_t g = rgb[3 * u + 1];
        const std::uint8_t b = rgb[3 * u + 2];
        red[u] = light_of_level_[r];
        green[u] = light_of_level_[g];
        blue[u] = light_of_level_[b];
        level[u] = static_cast<float>(g) / 255;
        const bool dark = std::max({r, g, b}) < kDarkLevel;
        empty[u] = outside[u] != 0 || dark ? 1 : 0;
        flags[u] = static_cast<std::uint8_t>(outside[u] | (highlight[u] != 0 ? kHighlight : 0) |
                                             (r >= kSaturatedLevel ? kRedSaturated : 0) |
                                             (g >= kSaturatedLevel ? kGreenSaturated : 0) |
                                             (b >= kSaturatedLevel ? kBlueSaturated : 0));
      }
    }
  });
  // The dark's border is soft.
  const cv::Mat dark(height_, width_, CV_8U, empty_.values.data());
  constexpr int kAcross = 2 * kSoftBorder + 1;
  cv::dilate(dark, dark, cv::getStructuringElement(cv::MORPH_RECT, {kAcross, kAcross}));
  std::transform(empty_.values.begin(), empty_.values.end(), highlights_.values.begin(),
                 empty_.values.begin(), std::bit_or<std::uint8_t>());
  filler_.fill(empty_, picture.green_level);
}

PictureFailure FrontEnd::judge(LinearPicture& picture) const {
  const PixelCounts counts = sum_rows(height_, PixelCounts(), [&](int v, PixelCounts& sum) {
    const std::uint8_t* rgb = undistorted_.data() + 3 * static_cast<std::ptrdiff_t>(v) * width_;
    const std::uint8_t* flags = picture.flags.row(v);
    for (int u = 0; u < width_; ++u) {
      if ((flags[u] & kOutside) != 0) continue;
      ++sum.inside;
      sum.saturated += (flags[u] & kAllSaturated) != 0 ? 1 : 0;
      sum.white += (flags[u] & kAllSaturated) == kAllSaturated ? 1 : 0;
      sum.highlight += (flags[u] & kHighlight) != 0 ? 1 : 0;
      sum.dark += std::max({rgb[3 * u], rgb[3 * u + 1], rgb[3 * u + 2]}) < kDarkLevel ? 1 : 0;
      sum.green_levels += rgb[3 * u + 1];
    }
  });
  const auto fraction = [&](std::int64_t count) {
    return static_cast<double>(count) /
           static_cast<double>(std::max(counts.inside, std::int64_t{1}));
  };
  picture.quality.mean_level = fraction(counts.green_levels) / 255;
  picture.quality.saturated_fraction = fraction(counts.saturated);
  picture.quality.dark_fraction = fraction(counts.dark);
  picture.quality.highlight_fraction = fraction(counts.highlight);
  const DifferenceEnergy across = difference_energy(picture.green_level, empty_, 1, 0);
  const DifferenceEnergy down = difference_energy(picture.green_level, empty_, 0, 1);
  picture.quality.sharpness = std::min(across.ratio(), down.ratio());
  picture.quality.contrast =
      std::sqrt((across.coarse + down.coarse) / std::max(across.count + down.count, 1)) /
      std::max(picture.quality.mean_level, 1.0 / 255);
  if (fraction(counts.dark) > kAllButAll)
    return {"black", "black picture: the lamp is off, or the lens is covered"};
  if (fraction(counts.white) > kAllButAll)
    return {"white", "white picture: exposed too long, or against the wall"};
  if (picture.quality.contrast < kLeastContrast) {
    return {"veiled", "veiled picture: fluid or a smear before the lens, or far out of focus"};
  }
  return {};
}

}  // namespace gastronaut::perception

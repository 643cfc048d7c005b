#include "depth_estimator/depth_estimator_process.hpp"

#include <fmt/format.h>
#include <zstd.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <stdexcept>

#include "gastronaut/depth_image_t.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

constexpr int kFastCompression = 1;
// Gains beyond are no camera's.
constexpr double kLeastGain = 1e-3;
constexpr double kMostGain = 1e3;
// One count is this part of the greatest depth: fine enough for normals.
constexpr double kCountsToMaxDepth = 32000;

std::optional<std::string> metadata(const image_t& picture, const std::string& key) {
  for (const image_metadata_t& entry : picture.metadata) {
    if (entry.key == key) return std::string(entry.value.begin(), entry.value.end());
  }
  return std::nullopt;
}

void add_metadata(image_t& picture, const std::string& key, const std::string& value) {
  image_metadata_t entry;
  entry.key = key;
  entry.value.assign(value.begin(), value.end());
  entry.n = static_cast<std::int32_t>(entry.value.size());
  picture.metadata.push_back(std::move(entry));
  picture.nmetadata = static_cast<std::int32_t>(picture.metadata.size());
}

// The gain that the camera tells; nothing for text that is no such number.
std::optional<double> told_gain(const image_t& picture) {
  const std::optional<std::string> text = metadata(picture, "gain");
  double gain = 0;
  if (!text) return std::nullopt;
  const char* end = text->data() + text->size();
  const auto [parsed_to, error] = std::from_chars(text->data(), end, gain);
  const bool possible = gain >= kLeastGain && gain <= kMostGain;
  if (error != std::errc() || parsed_to != end || !possible) return std::nullopt;
  return gain;
}

std::optional<perception::PixelFormat> pixel_format(std::int32_t format) {
  switch (format) {
    case image_t::PIXEL_FORMAT_MJPEG:
      return perception::PixelFormat::kMjpeg;
    case image_t::PIXEL_FORMAT_GRAY:
      return perception::PixelFormat::kGray;
    case image_t::PIXEL_FORMAT_RGB:
      return perception::PixelFormat::kRgb;
    case image_t::PIXEL_FORMAT_BGR:
      return perception::PixelFormat::kBgr;
    default:
      return std::nullopt;
  }
}

image_t gray_message(std::int64_t utime, const CameraConfiguration& camera,
                     const Plane<std::uint8_t>& plane) {
  image_t message;
  message.utime = utime;
  message.width = camera.width;
  message.height = camera.height;
  message.row_stride = camera.width;
  message.pixelformat = image_t::PIXEL_FORMAT_GRAY;
  message.data = plane.values;
  // Nothing to show: black.
  message.data.resize(static_cast<std::size_t>(camera.width) *
                      static_cast<std::size_t>(camera.height));
  message.size = static_cast<std::int32_t>(message.data.size());
  message.nmetadata = 0;
  return message;
}

depth_image_t depth_message(std::int64_t utime, const perception::Perception& perception,
                            double metres_per_count) {
  const PinholeGrid& grid = perception.grid;
  depth_image_t message;
  message.utime = utime;
  message.width = grid.width;
  message.height = grid.height;
  message.fx = grid.fx;
  message.fy = grid.fy;
  message.cx = grid.cx;
  message.cy = grid.cy;
  message.metres_per_count = metres_per_count;
  message.relative_std = perception.relative_std;
  message.encoding = depth_image_t::ENCODING_ZSTD;
  std::vector<std::uint16_t> counts(static_cast<std::size_t>(grid.width) *
                                    static_cast<std::size_t>(grid.height));
  if (!perception.failure) {
    constexpr double kMostCounts = std::numeric_limits<std::uint16_t>::max();
    std::transform(perception.depth.values.begin(), perception.depth.values.end(), counts.begin(),
                   [&](float depth) {
                     return static_cast<std::uint16_t>(std::min(
                         kMostCounts, std::round(static_cast<double>(depth) / metres_per_count)));
                   });
  }
  const std::size_t bytes = counts.size() * sizeof counts.front();
  message.data.resize(ZSTD_compressBound(bytes));
  const std::size_t size = ZSTD_compress(message.data.data(), message.data.size(), counts.data(),
                                         bytes, kFastCompression);
  if (ZSTD_isError(size) != 0) {
    throw std::runtime_error(std::string("zstd: ") + ZSTD_getErrorName(size));
  }
  message.data.resize(size);
  message.size = static_cast<std::int32_t>(size);
  return message;
}

}  // namespace

DepthEstimatorProcess::DepthEstimatorProcess(Bus& bus, const RigConfiguration& configuration)
    : bus_(bus), configuration_(configuration), estimator_(configuration) {
  bus.subscribe<image_t>(
      channel::kCamera, configuration.lag.camera,
      [this](const image_t& picture) { handle_picture(picture); }, Overload::kKeepNewest);
}

void DepthEstimatorProcess::handle_picture(const image_t& picture) {
  std::optional<double> gain = told_gain(picture);
  if (!gain && !configuration_.camera.auto_exposure) gain = 1;
  const std::optional<perception::PixelFormat> format = pixel_format(picture.pixelformat);
  const perception::Perception& seen =
      format ? estimator_.estimate(
                   {picture.width, picture.height, picture.row_stride, *format, picture.data}, gain)
             : estimator_.refuse(
                   {"corrupt", fmt::format("pixel format {} is unknown", picture.pixelformat)});

  image_t albedo = gray_message(picture.utime, configuration_.camera, seen.albedo);
  if (const std::optional<std::string> seq = metadata(picture, "seq")) {
    add_metadata(albedo, "seq", *seq);
  }
  for (const auto& [key, value] : {std::pair{"sharpness", seen.quality.sharpness},
                                   {"contrast", seen.quality.contrast},
                                   {"mean_level", seen.quality.mean_level},
                                   {"saturated_fraction", seen.quality.saturated_fraction},
                                   {"dark_fraction", seen.quality.dark_fraction},
                                   {"highlight_fraction", seen.quality.highlight_fraction}}) {
    add_metadata(albedo, key, fmt::format("{:.6g}", value));
  }
  if (seen.failure) {
    add_metadata(albedo, "failure", seen.failure.kind);
    add_metadata(albedo, "failure_message", seen.failure.message);
  }
  // DEPTH last: whoever joins the three has the others by then.
  bus_.publish(channel::kVessels, gray_message(picture.utime, configuration_.camera, seen.vessels));
  bus_.publish(channel::kAlbedo, albedo);
  if (configuration_.depth_estimator.depth == DepthSource::kShading) {
    bus_.publish(channel::kDepth,
                 depth_message(picture.utime, seen,
                               configuration_.depth_estimator.max_depth / kCountsToMaxDepth));
  }
  report(seen.failure);
}

// The count stays for good: a single bad picture among many would else be seen by nobody.
void DepthEstimatorProcess::report(const perception::PictureFailure& failure) {
  ++pictures_;
  if (failure) {
    ++failures_;
    last_failure_ = failure.message;
  }
  if (failures_ == 0) return;
  bus_.set_health(
      failure ? ProcessState::kDegraded : ProcessState::kRunning,
      fmt::format("{} of {} pictures not used, last: {}", failures_, pictures_, last_failure_));
}

ProcessDescription depth_estimator_process() {
  return {"depth_estimator",
          "Metric depth, albedo and vessels from each camera picture.",
          channel::kCamera,
          [](const RigConfiguration& configuration) {
            std::vector<std::string> outputs = {channel::kAlbedo, channel::kVessels};
            if (configuration.depth_estimator.depth == DepthSource::kShading) {
              outputs.push_back(channel::kDepth);
            }
            return outputs;
          },
          [](Bus& bus, const RigConfiguration& configuration) {
            return std::make_unique<DepthEstimatorProcess>(bus, configuration);
          },
          {}};
}

}  // namespace gastronaut

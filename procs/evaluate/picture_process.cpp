#include "evaluate/picture_process.hpp"

#include <algorithm>
#include <cmath>
#include <gastronaut/depth_image_t.hpp>
#include <gastronaut/image_t.hpp>

#include "bus/log_file.hpp"
#include "bus/wire.hpp"
#include "pictures/depth_counts.hpp"
#include "process/channels.hpp"

namespace gastronaut::evaluation {
namespace {

// The pictures of one utime may be this many frames apart in the log.
constexpr std::size_t kMaxPendingFrames = 32;

std::optional<ColourPicture> decode_camera(const image_t& message) {
  PictureEncoding encoding = PictureEncoding::kJpeg;
  switch (message.pixelformat) {
    case image_t::PIXEL_FORMAT_MJPEG:
      break;
    case image_t::PIXEL_FORMAT_GRAY:
      encoding = PictureEncoding::kGray;
      break;
    case image_t::PIXEL_FORMAT_RGB:
      encoding = PictureEncoding::kRgb;
      break;
    case image_t::PIXEL_FORMAT_BGR:
      encoding = PictureEncoding::kBgr;
      break;
    default:
      return std::nullopt;
  }
  return decode_colour(encoding, message.data, message.width, message.height, message.row_stride);
}

std::optional<Levels> decode_gray(const image_t& message) {
  if (message.pixelformat != image_t::PIXEL_FORMAT_GRAY) return std::nullopt;
  return decode_levels(message.data, message.width, message.height, message.row_stride);
}

std::vector<std::pair<std::string, std::string>> metadata_of(const image_t& message) {
  std::vector<std::pair<std::string, std::string>> metadata;
  for (const image_metadata_t& entry : message.metadata) {
    metadata.emplace_back(entry.key, std::string(entry.value.begin(), entry.value.end()));
  }
  return metadata;
}

class FrameReader {
 public:
  FrameReader(std::span<const std::int64_t> utimes, PictureProblems& problems,
              const std::function<void(const Frame&)>& use)
      : utimes_(utimes), problems_(problems), use_(use) {}

  void handle(const LogReader::Event& event) {
    if (event.channel == channel::kCamera) {
      take<image_t>(event, &Frame::camera, decode_camera);
    } else if (event.channel == channel::kDepth) {
      take<depth_image_t>(event, &Frame::depth, decode_depth);
    } else if (event.channel == channel::kGroundTruthDepth) {
      take<depth_image_t>(event, &Frame::truth, decode_depth);
    } else if (event.channel == channel::kAlbedo) {
      take<image_t>(event, &Frame::albedo, decode_gray);
    } else if (event.channel == channel::kVessels) {
      take<image_t>(event, &Frame::vessels, decode_gray);
    }
  }

  void finish() {
    while (!pending_.empty()) use_oldest();
  }

 private:
  template <class Message, class Picture, class Decode>
  void take(const LogReader::Event& event, std::optional<Picture> Frame::*place,
            const Decode& decode) {
    Message message;
    // Damaged messages were counted when the poses were read.
    if (decode_message(event.payload, message) != DecodeResult::kOk) return;
    if (!std::binary_search(utimes_.begin(), utimes_.end(), message.utime)) return;
    Frame& frame = pending_[message.utime];
    frame.utime = message.utime;
    if (frame.*place) return;
    frame.*place = decode(message);
    if (!(frame.*place)) {
      ++problems_[event.channel + ": the data are damaged or not of the size the message says"];
    }
    if constexpr (std::is_same_v<Message, image_t>) {
      if (event.channel == channel::kAlbedo) frame.metadata = metadata_of(message);
    }
    if (pending_.size() > kMaxPendingFrames) use_oldest();
  }

  void use_oldest() {
    use_(pending_.begin()->second);
    pending_.erase(pending_.begin());
  }

  std::span<const std::int64_t> utimes_;
  PictureProblems& problems_;
  const std::function<void(const Frame&)>& use_;
  std::map<std::int64_t, Frame> pending_;
};

}  // namespace

std::optional<DepthPicture> decode_depth(const depth_image_t& message) {
  const std::optional<DepthEncoding> encoding = depth_encoding(message.encoding);
  if (!encoding) return std::nullopt;
  const auto positive = [](double value) { return value > 0 && std::isfinite(value); };
  if (!positive(message.fx) || !positive(message.fy) || !positive(message.metres_per_count) ||
      !std::isfinite(message.cx) || !std::isfinite(message.cy)) {
    return std::nullopt;
  }
  const auto counts = decode_depth_counts(*encoding, message.data, message.width, message.height);
  if (!counts) return std::nullopt;
  DepthPicture picture{message.width, message.height, message.fx, message.fy,
                       message.cx,    message.cy,     {},         0};
  picture.depth.reserve(counts->size());
  for (const std::uint16_t count : *counts) {
    picture.depth.push_back(static_cast<float>(count * message.metres_per_count));
  }
  if (positive(message.relative_std)) picture.relative_std = message.relative_std;
  return picture;
}

std::string failure_of(const image_t& message) {
  for (const auto& [key, value] : metadata_of(message)) {
    if (key == "failure") return value;
  }
  return "";
}

void read_frames(const std::string& log, std::span<const std::int64_t> utimes,
                 PictureProblems& problems, const std::function<void(const Frame&)>& use,
                 const std::function<void(double)>& progress) {
  LogReader reader(log);
  FrameReader frames(utimes, problems, use);
  while (const auto event = reader.next()) {
    frames.handle(*event);
    progress(static_cast<double>(reader.offset()) / static_cast<double>(reader.size()));
  }
  frames.finish();
}

void read_true_depths(const std::string& log,
                      const std::function<void(std::int64_t utime, const DepthPicture&)>& use,
                      const std::function<void(double)>& progress) {
  LogReader reader(log);
  while (const auto event = reader.next()) {
    progress(static_cast<double>(reader.offset()) / static_cast<double>(reader.size()));
    if (event->channel != channel::kGroundTruthDepth) continue;
    depth_image_t message;
    if (decode_message(event->payload, message) != DecodeResult::kOk) continue;
    if (const auto picture = decode_depth(message)) use(message.utime, *picture);
  }
}

}  // namespace gastronaut::evaluation

#include "import/frame_source.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <opencv2/videoio.hpp>
#include <set>
#include <stdexcept>

#include "import/files.hpp"
#include "import/timeline.hpp"

namespace gastronaut {
namespace {

class FrameFilesSource : public FrameSource {
 public:
  FrameFilesSource(std::vector<FrameFiles> files, PictureSize expected)
      : files_(std::move(files)), expected_(expected), jpeg_(expected) {}

  std::optional<Frame> next(Issues& issues) override {
    if (next_ == files_.size()) return std::nullopt;
    const FrameFiles& files = files_[next_++];
    Frame frame;
    frame.utime = files.utime;
    frame.seq = files.seq;
    const auto read = [&issues](const std::string& path, const auto& decode) {
      std::vector<std::uint8_t> bytes;
      try {
        bytes = read_file(path);
      } catch (const std::runtime_error& problem) {
        issues.left_out(std::string(problem.what()) + "; skipped");
        return;
      }
      try {
        decode(std::move(bytes));
      } catch (const std::runtime_error& problem) {
        issues.left_out(path + ": " + problem.what() + "; skipped");
      }
    };
    read(files.picture,
         [&](std::vector<std::uint8_t> bytes) { frame.jpeg = jpeg_.to_jpeg(std::move(bytes)); });
    if (!files.depth.empty()) {
      read(files.depth, [&](const std::vector<std::uint8_t>& bytes) {
        frame.depth = decode_depth(bytes, expected_);
      });
    }
    return frame;
  }

  std::size_t count() const override { return files_.size(); }

 private:
  std::vector<FrameFiles> files_;
  PictureSize expected_;
  JpegMaker jpeg_;
  std::size_t next_ = 0;
};

class VideoSource : public FrameSource {
 public:
  VideoSource(const std::string& path, double epoch, double& rate, PictureSize expected)
      : path_(path), video_(path, cv::CAP_FFMPEG), epoch_(epoch), jpeg_(expected) {
    if (!video_.isOpened()) {
      throw std::runtime_error(path + ": is neither a folder nor a video that OpenCV can open");
    }
    if (rate == 0) rate = video_.get(cv::CAP_PROP_FPS);
    if (!(rate > 0) || !std::isfinite(rate)) {
      throw std::runtime_error(path + ": does not say its frame rate; give it with --rate");
    }
    rate_ = rate;
  }

  std::optional<Frame> next(Issues& issues) override {
    cv::Mat picture;
    if (!video_.read(picture)) return std::nullopt;
    Frame frame;
    frame.utime = to_utime(seq_ / rate_, epoch_);
    frame.seq = seq_++;
    try {
      frame.jpeg = jpeg_.encode(picture);
    } catch (const std::runtime_error& problem) {
      issues.left_out(path_ + ": frame " + std::to_string(frame.seq) + " " + problem.what() +
                      "; skipped");
    }
    return frame;
  }

  std::size_t count() const override {
    return static_cast<std::size_t>(std::max(0.0, video_.get(cv::CAP_PROP_FRAME_COUNT)));
  }

 private:
  std::string path_;
  cv::VideoCapture video_;
  double epoch_;
  double rate_ = 0;
  JpegMaker jpeg_;
  std::int32_t seq_ = 0;
};

// The last run of digits in the file's name; nothing when there is none, or it is no int32.
std::optional<std::int32_t> number_of(const std::string& stem) {
  constexpr const char* kDigits = "0123456789";
  const std::size_t last = stem.find_last_of(kDigits);
  if (last == std::string::npos) return std::nullopt;
  const std::size_t before = stem.find_last_not_of(kDigits, last);
  const std::size_t first = before == std::string::npos ? 0 : before + 1;
  std::int32_t number = 0;
  const auto parsed = std::from_chars(&stem[first], &stem[last] + 1, number);
  if (parsed.ec != std::errc()) return std::nullopt;
  return number;
}

}  // namespace

std::unique_ptr<FrameSource> open_frame_files(std::vector<FrameFiles> files, PictureSize expected) {
  return std::make_unique<FrameFilesSource>(std::move(files), expected);
}

std::unique_ptr<FrameSource> open_video(const std::string& path, double epoch, double& rate,
                                        PictureSize expected) {
  return std::make_unique<VideoSource>(path, epoch, rate, expected);
}

std::vector<NumberedFile> list_numbered_pictures(const std::string& folder) {
  static const std::set<std::string> kPictures = {".jpg",  ".jpeg", ".png", ".bmp", ".tif",
                                                  ".tiff", ".ppm",  ".pgm", ".webp"};
  std::vector<NumberedFile> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    std::string extension = entry.path().extension().string();
    for (char& letter : extension) {
      if (letter >= 'A' && letter <= 'Z') letter = static_cast<char>(letter - 'A' + 'a');
    }
    if (!entry.is_regular_file() || !kPictures.contains(extension)) continue;
    if (const auto number = number_of(entry.path().stem().string())) {
      files.push_back({*number, entry.path().string()});
    }
  }
  if (files.empty()) {
    throw std::runtime_error(folder +
                             ": holds no pictures; expected files named by their number, "
                             "000000.jpg and so on");
  }
  std::sort(files.begin(), files.end(), [](const NumberedFile& a, const NumberedFile& b) {
    return a.number != b.number ? a.number < b.number : a.path < b.path;
  });
  const auto twice =
      std::adjacent_find(files.begin(), files.end(),
                         [](const auto& a, const auto& b) { return a.number == b.number; });
  if (twice != files.end()) {
    throw std::runtime_error((twice + 1)->path + ": has the same number as " + twice->path);
  }
  return files;
}

}  // namespace gastronaut

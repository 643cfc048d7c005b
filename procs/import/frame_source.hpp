// Pictures one after the other, from files or a video.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "import/issues.hpp"
#include "import/pictures.hpp"

namespace gastronaut {

struct Frame {
  std::int64_t utime = 0;  // microseconds
  std::int32_t seq = 0;
  std::vector<std::uint8_t> jpeg;    // empty: no usable picture
  std::vector<std::uint16_t> depth;  // counts on the lens picture's pixels; empty: none
};

// Where a frame is kept.
struct FrameFiles {
  std::int64_t utime = 0;
  std::int32_t seq = 0;
  std::string picture;
  std::string depth;  // empty: none
};

class FrameSource {
 public:
  virtual ~FrameSource() = default;
  // In ascending order of utime; what is damaged is reported and left out. Nothing at the end.
  virtual std::optional<Frame> next(Issues& issues) = 0;
  // How many frames there are to read, for progress; a video may be wrong about itself.
  virtual std::size_t count() const = 0;
};

// `files` in strictly ascending order of utime.
std::unique_ptr<FrameSource> open_frame_files(std::vector<FrameFiles> files, PictureSize expected);

// Frame N at epoch + N / rate, rate 0: as the video says. Throws std::runtime_error for what OpenCV
// cannot open and for a video that does not say its rate.
std::unique_ptr<FrameSource> open_video(const std::string& path, double epoch, double& rate,
                                        PictureSize expected);

struct NumberedFile {
  std::int32_t number = 0;
  std::string path;
};

// The folder's pictures whose names end in a number ("000012.jpg", "frame_12.png"), ascending by
// number. Throws std::runtime_error when there are none, or two of the same number.
std::vector<NumberedFile> list_numbered_pictures(const std::string& folder);

}  // namespace gastronaut

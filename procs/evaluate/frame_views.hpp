// Pictures of chosen frames for the eye, as small files that report.py draws side by side.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "evaluate/picture_process.hpp"

namespace gastronaut::evaluation {

// Numbers of the frames to show, ascending: those asked for, or a few spread evenly over `count`
// frames. What is asked for in vain is said in `notes`.
std::vector<std::size_t> choose_frames(std::size_t count, const std::vector<std::size_t>& requested,
                                       std::vector<std::string>& notes);

class FrameViews {
 public:
  // Files go to FOLDER/frames. Throws std::runtime_error, as the functions below, when they cannot
  // be written.
  explicit FrameViews(const std::string& folder);

  // `input`: the camera's picture, undistorted, when there is one.
  void write(std::size_t number, double seconds, const Frame& frame,
             const std::optional<ColourPicture>& input);
  // The list of what was written.
  void write_index() const;

 private:
  std::string folder_;
  std::vector<std::string> entries_;  // JSON
};

}  // namespace gastronaut::evaluation

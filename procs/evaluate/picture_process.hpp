// Reads the pictures of chosen frames out of a log: with evaluate_process the only part of the
// evaluation that knows channels and LCM types.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "evaluate/depth_errors.hpp"
#include "evaluate/pictures.hpp"

namespace gastronaut {
class depth_image_t;
class image_t;
}  // namespace gastronaut

namespace gastronaut::evaluation {

// All pictures of one utime. What the log does not hold or cannot be decoded is left out.
struct Frame {
  std::int64_t utime = 0;
  std::optional<ColourPicture> camera;  // as the lens saw it
  std::optional<DepthPicture> depth;
  std::optional<DepthPicture> truth;
  std::optional<Levels> albedo;
  std::optional<Levels> vessels;
  std::vector<std::pair<std::string, std::string>> metadata;  // of ALBEDO
};

// What is wrong with pictures, and with how many.
using PictureProblems = std::map<std::string, std::size_t>;

// Nothing for data that are not what the message says.
std::optional<DepthPicture> decode_depth(const depth_image_t& message);
// Value of ALBEDO's metadata "failure"; empty: none.
std::string failure_of(const image_t& message);

// Hands the frames of these utimes (ascending) to `use`, one after the other. `progress` gets the
// fraction that is read. Throws std::runtime_error when the log cannot be opened.
void read_frames(const std::string& log, std::span<const std::int64_t> utimes,
                 PictureProblems& problems, const std::function<void(const Frame&)>& use,
                 const std::function<void(double)>& progress);

// Hands the pictures of GROUND_TRUTH_DEPTH to `use`, in the log's order; those that cannot be
// decoded are left out. `progress` and errors as above.
void read_true_depths(const std::string& log,
                      const std::function<void(std::int64_t utime, const DepthPicture&)>& use,
                      const std::function<void(double)>& progress);

}  // namespace gastronaut::evaluation

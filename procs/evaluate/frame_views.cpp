#include "evaluate/frame_views.hpp"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <limits>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>

namespace gastronaut::evaluation {
namespace {

constexpr std::size_t kDefaultViews = 6;

void write_picture(const std::string& path, const cv::Mat& picture) {
  if (!cv::imwrite(path, picture)) throw std::runtime_error("cannot write " + path);
}

template <class Value>
cv::Mat view(const Plane<Value>& plane, int type) {
  // Mat takes no const; the pixels are only read.
  return {plane.height, plane.width, type, const_cast<Value*>(plane.values.data())};
}

float farthest(const std::optional<DepthPicture>& picture) {
  return picture ? *std::max_element(picture->depth.begin(), picture->depth.end()) : 0;
}

}  // namespace

std::vector<std::size_t> choose_frames(std::size_t count, const std::vector<std::size_t>& requested,
                                       std::vector<std::string>& notes) {
  std::vector<std::size_t> chosen;
  if (count == 0) return chosen;
  if (requested.empty()) {
    // The middles of as many equal parts: the first and last pictures are often special.
    const std::size_t wanted = std::min(count, kDefaultViews);
    for (std::size_t i = 0; i < wanted; ++i) {
      chosen.push_back((2 * i + 1) * count / (2 * wanted));
    }
  }
  for (const std::size_t number : requested) {
    if (number < count) {
      chosen.push_back(number);
    } else {
      notes.push_back("there is no frame " + std::to_string(number) +
                      " to show: the log has 0 to " + std::to_string(count - 1));
    }
  }
  std::sort(chosen.begin(), chosen.end());
  chosen.erase(std::unique(chosen.begin(), chosen.end()), chosen.end());
  return chosen;
}

FrameViews::FrameViews(const std::string& folder) : folder_(folder + "/frames") {
  std::error_code error;
  std::filesystem::create_directories(folder_, error);
  if (error) throw std::runtime_error("cannot make " + folder_ + ": " + error.message());
}

void FrameViews::write(std::size_t number, double seconds, const Frame& frame,
                       const std::optional<ColourPicture>& input) {
  nlohmann::ordered_json entry;
  entry["number"] = number;
  entry["seconds"] = seconds;
  auto files = nlohmann::ordered_json::object();
  const auto write = [&](const char* kind, const cv::Mat& picture) {
    const std::string name = std::to_string(number) + "_" + kind + ".png";
    write_picture(folder_ + "/" + name, picture);
    files[kind] = name;
  };
  if (input) write("input", view(*input, CV_8UC3));
  if (frame.albedo) write("albedo", view(*frame.albedo, CV_8U));
  if (frame.vessels) write("vessels", view(*frame.vessels, CV_8U));

  // One scale for all of a frame's depths, so that 16 bits reach the farthest.
  const double largest = std::max(farthest(frame.depth), farthest(frame.truth));
  const double metres_per_count =
      largest > 0 ? largest / std::numeric_limits<std::uint16_t>::max() : 1;
  entry["metres_per_count"] = metres_per_count;
  const auto write_depth = [&](const char* kind, const DepthPicture& grid,
                               const std::vector<float>& metres) {
    cv::Mat counts;
    cv::Mat(grid.height, grid.width, CV_32F, const_cast<float*>(metres.data()))
        .convertTo(counts, CV_16U, 1 / metres_per_count);
    write(kind, counts);
  };
  if (frame.depth) {
    const DepthPicture& depth = *frame.depth;
    write_depth("depth", depth, depth.depth);
    entry["pinhole"] = {depth.fx, depth.fy, depth.cx, depth.cy};
    entry["relative_std"] = depth.relative_std;
  }
  if (frame.truth) write_depth("truth", *frame.truth, frame.truth->depth);
  if (frame.depth && frame.truth) {
    write_depth("depth_at_truth", *frame.truth, resample_like(*frame.depth, *frame.truth));
  }
  auto metadata = nlohmann::ordered_json::object();
  for (const auto& [key, value] : frame.metadata) metadata[key] = value;
  entry["files"] = files;
  entry["metadata"] = metadata;
  // A damaged log may have brought bytes that are no text.
  entries_.push_back(entry.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace));
}

void FrameViews::write_index() const {
  const std::string path = folder_ + "/frames.json";
  std::ofstream file(path);
  file << "[";
  for (std::size_t i = 0; i < entries_.size(); ++i) file << (i > 0 ? ",\n" : "\n") << entries_[i];
  file << "\n]\n";
  if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

}  // namespace gastronaut::evaluation

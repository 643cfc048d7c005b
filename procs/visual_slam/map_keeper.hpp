// Keeps the map on disk while it grows, without holding anybody up.
#pragma once

#include <future>
#include <string>

#include "visual_slam/surfel_file.hpp"

namespace gastronaut::slam {

class MapKeeper {
 public:
  // `path`: where save_map writes to.
  explicit MapKeeper(std::string path) : path_(std::move(path)) {}

  // Whether a snapshot would be taken now.
  bool is_free() const;
  // Writes the snapshot on a thread of its own. While one is being written, false: it is not taken.
  bool save(KeptMap snapshot);
  // Waits for what is being written.
  void wait();
  // Why the last snapshot that was finished could not be kept; empty: it was.
  const std::string& problem();

 private:
  void collect();

  std::string path_;
  std::future<std::string> writing_;
  std::string problem_;
};

}  // namespace gastronaut::slam

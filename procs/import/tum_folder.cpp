#include "import/tum_folder.hpp"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <stdexcept>

#include "import/files.hpp"
#include "import/table.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

constexpr double kSince1970 = 0;  // the files' times are absolute

struct ListedFiles {
  std::vector<std::int64_t> utimes;
  std::vector<std::string> paths;
};

ListedFiles read_list(const std::string& folder, const std::string& name, Issues& issues) {
  const std::string list = folder + "/" + name;
  const std::string text = read_text(list);
  std::vector<std::int64_t> utimes;
  std::vector<std::string> paths;
  std::vector<std::size_t> lines;
  for_each_row(text, [&](std::size_t line, std::span<const std::string_view> cells) {
    const auto time = parse_number(cells[0]);
    if (cells.size() != 2 || !time) {
      issues.left_out(place(list, line) + ": not a time and a file; row skipped");
      return;
    }
    utimes.push_back(to_utime(*time, kSince1970));
    paths.push_back(folder + "/" + std::string(cells[1]));
    lines.push_back(line);
  });
  ListedFiles files;
  for (const std::size_t i : forward_in_time(
           utimes, issues, [&](std::size_t index) { return place(list, lines[index]); })) {
    files.utimes.push_back(utimes[i]);
    files.paths.push_back(std::move(paths[i]));
  }
  if (files.utimes.empty()) {
    throw std::runtime_error(list +
                             ": has no usable row; expected the time in seconds and a file "
                             "in each");
  }
  return files;
}

std::size_t nearest(const std::vector<std::int64_t>& utimes, std::int64_t utime) {
  const auto after = std::lower_bound(utimes.begin(), utimes.end(), utime);
  if (after == utimes.begin()) return 0;
  const bool before_is_nearer = after == utimes.end() || utime - *(after - 1) <= *after - utime;
  return static_cast<std::size_t>(after - utimes.begin()) - (before_is_nearer ? 1 : 0);
}

}  // namespace

std::vector<std::pair<std::size_t, std::size_t>> associate(const std::vector<std::int64_t>& a,
                                                           const std::vector<std::int64_t>& b,
                                                           std::int64_t limit) {
  std::vector<std::pair<std::size_t, std::size_t>> pairs;
  if (b.empty()) return pairs;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const std::size_t j = nearest(b, a[i]);
    if (nearest(a, b[j]) == i && std::abs(a[i] - b[j]) <= limit) pairs.emplace_back(i, j);
  }
  return pairs;
}

Recording open_tum_folder(const std::string& folder, const RigConfiguration& rig,
                          double depth_relative_std, Issues& issues) {
  if (!std::filesystem::exists(folder + "/rgb.txt")) {
    throw std::runtime_error(folder +
                             ": rgb.txt is missing; expected a TUM RGB-D folder: rgb.txt, "
                             "depth.txt and groundtruth.txt, the first two with rows of "
                             "'time file'");
  }
  Recording recording;
  recording.rig = rig;
  recording.depth_kind = DepthKind::kSensor;
  recording.depth_relative_std = depth_relative_std;

  const ListedFiles pictures = read_list(folder, "rgb.txt", issues);
  std::vector<FrameFiles> frames;
  for (std::size_t i = 0; i < pictures.utimes.size(); ++i) {
    frames.push_back({pictures.utimes[i], static_cast<std::int32_t>(i), pictures.paths[i], {}});
  }
  if (has_part(folder, "depth.txt", channel::kDepth)) {
    constexpr std::int64_t kSamePicture = 20'000;  // microseconds, the benchmark's own limit
    const ListedFiles depth = read_list(folder, "depth.txt", issues);
    const auto pairs = associate(pictures.utimes, depth.utimes, kSamePicture);
    for (const auto& [i, j] : pairs) frames[i].depth = depth.paths[j];
    spdlog::info("{}: {} of {} pictures have depth", folder, pairs.size(), frames.size());
  }
  if (has_part(folder, "groundtruth.txt", channel::kGroundTruthPose)) {
    constexpr std::int64_t kMargin = 1'000'000;  // microseconds
    recording.poses =
        read_poses(folder + "/groundtruth.txt", 1 / rig.camera.rate, kSince1970, issues);
    const std::size_t outside = std::erase_if(recording.poses, [&](const StampedPose& pose) {
      return pose.utime < pictures.utimes.front() - kMargin ||
             pose.utime > pictures.utimes.back() + kMargin;
    });
    spdlog::info("{}/groundtruth.txt: {} poses; {} more lie over a second from every picture",
                 folder, recording.poses.size(), outside);
  }
  recording.frames = open_frame_files(std::move(frames), {rig.camera.width, rig.camera.height});
  return recording;
}

}  // namespace gastronaut

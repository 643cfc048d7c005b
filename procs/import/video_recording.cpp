#include "import/video_recording.hpp"

#include <algorithm>
#include <filesystem>
#include <map>
#include <stdexcept>

#include "import/files.hpp"
#include "import/table.hpp"

namespace gastronaut {
namespace {

std::vector<FrameFiles> list_frames(const VideoFiles& files, double rate, double epoch) {
  std::map<std::int32_t, std::string> depth;
  if (!files.depth.empty()) {
    for (NumberedFile& file : list_numbered_pictures(files.depth)) {
      depth[file.number] = std::move(file.path);
    }
  }
  const std::vector<NumberedFile> pictures = list_numbered_pictures(files.pictures);
  std::vector<FrameFiles> frames;
  for (const NumberedFile& file : pictures) {
    const double frames_from_start = static_cast<double>(file.number) - pictures.front().number;
    const auto found = depth.find(file.number);
    frames.push_back({to_utime(frames_from_start / rate, epoch), file.number, file.path,
                      found != depth.end() ? found->second : std::string()});
  }
  return frames;
}

// One current for each coil: as many as the rig has, or, where that is not known, as the file has.
std::size_t count_coils(const RigConfiguration& rig, const std::string& path) {
  auto coils = static_cast<std::size_t>(rig.coils.tesla_per_ampere.cols());
  if (coils > 0) return coils;
  for_each_row(read_text(path), [&](std::size_t, std::span<const std::string_view> cells) {
    if (coils == 0) coils = cells.size() - 1;
  });
  if (coils == 0) throw std::runtime_error(path + ": has no usable row of a time and currents");
  return coils;
}

}  // namespace

Recording open_video_recording(const VideoFiles& files, const RigConfiguration& rig, double epoch,
                               Issues& issues) {
  for (const std::string& file :
       {files.pictures, files.depth, files.hall, files.coils, files.poses}) {
    if (!file.empty() && !std::filesystem::exists(file)) {
      throw std::runtime_error(file + ": does not exist");
    }
  }
  Recording recording;
  recording.rig = rig;
  recording.depth_kind = DepthKind::kSensor;
  recording.depth_relative_std = files.depth_relative_std;
  const PictureSize size{rig.camera.width, rig.camera.height};
  double& rate = recording.rig.camera.rate;
  if (std::filesystem::is_directory(files.pictures)) {
    if (files.rate > 0) rate = files.rate;
    recording.frames = open_frame_files(list_frames(files, rate, epoch), size);
  } else {
    if (!files.depth.empty()) {
      throw std::runtime_error("--depth goes with a folder of pictures, not with a video");
    }
    rate = files.rate;
    recording.frames = open_video(files.pictures, epoch, rate, size);
  }
  if (!files.hall.empty()) {
    const auto channels =
        static_cast<std::size_t>(rig.hall_array.num_sensors() * rig.hall_array.num_axes);
    recording.hall = read_series(files.hall, channels, epoch, issues);
  }
  if (!files.coils.empty()) {
    recording.coil_currents =
        read_series(files.coils, count_coils(rig, files.coils), epoch, issues);
  }
  if (!files.poses.empty()) recording.poses = read_poses(files.poses, 1 / rate, epoch, issues);
  return recording;
}

}  // namespace gastronaut

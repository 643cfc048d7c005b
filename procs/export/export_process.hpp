// Reads a log and writes what it holds as files for other programs; the only part of export that
// knows channels and LCM types.
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

namespace gastronaut {

struct ExportOptions {
  std::string log;
  std::string folder;  // exists
  bool csv = true;
  bool tum = true;
  bool ply = true;
  bool mesh = true;
  bool octomap = true;
  std::vector<std::size_t> after_frames;  // with ply: snapshots after so many VISUAL_POSE
};

struct ExportResult {
  std::vector<std::string> files;  // written, by name
  std::vector<std::string> notes;  // what was left out, and why
};

// Writes into the folder, whole files only:
//   CHANNEL.csv of every channel with messages of one of our types: see message_table.hpp;
//   CHANNEL.tum of every pose channel, without the poses that their status says not to use:
//   seconds,
//     metres, unit quaternion x y z w; MAGNETIC_POSE is the magnet's (its roll is arbitrary),
//     VISUAL_POSE the camera's in the map's frame, all others the camera's in the rig's;
//   map.ply: the surfels after the last MAP_SURFELS, map frame (surfel_file.hpp), and
//     map_after_N.ply: those after the first MAP_SURFELS at or after the Nth VISUAL_POSE;
//   mesh.ply: triangles between the stable ones of these, with colour (surfel_mesh.hpp);
//   octomap.bt or octomap.ot: the last OCTOMAP.
// Channels with characters that are no letter, digit, _ or - get _ for them in file names. Throws
// std::runtime_error for a log that cannot be opened and for files that cannot be written.
ExportResult export_log(const ExportOptions& options, const std::function<void(double)>& progress);

}  // namespace gastronaut

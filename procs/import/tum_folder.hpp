// Folders of the TUM RGB-D benchmark: rgb.txt and depth.txt list "time file", groundtruth.txt is a
// trajectory. Depth is what a sensor measured, on the colour picture's pixels.
#pragma once

#include <string>
#include <vector>

#include "import/recording.hpp"

namespace gastronaut {

// Pairs of indices (a, b) such that each is the other's nearest in time, at most `limit`
// microseconds apart. Both ascending.
std::vector<std::pair<std::size_t, std::size_t>> associate(const std::vector<std::int64_t>& a,
                                                           const std::vector<std::int64_t>& b,
                                                           std::int64_t limit);

// `rig` has the camera. Times are those of the files, seconds since 1970. Poses further than a
// second from every picture are left out. Throws std::runtime_error for files that are missing.
Recording open_tum_folder(const std::string& folder, const RigConfiguration& rig,
                          double depth_relative_std, Issues& issues);

}  // namespace gastronaut

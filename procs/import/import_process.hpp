// Writes a recording as an LCM log: RIG_CONFIG at the start and every 10 s, and every channel that
// the recording has, all in order of utime.
#pragma once

#include <cstddef>
#include <map>
#include <string>

#include "import/recording.hpp"

namespace gastronaut {

// Messages by channel.
using ImportCounts = std::map<std::string, std::size_t>;

// Throws std::runtime_error when nothing usable is left or the log cannot be written; there is
// nothing under `path` then.
ImportCounts write_recording(Recording recording, const std::string& path, Issues& issues);

}  // namespace gastronaut

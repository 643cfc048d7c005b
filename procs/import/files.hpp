// Files and folders of a recording.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace gastronaut {

// Both throw std::runtime_error for what cannot be read.
std::vector<std::uint8_t> read_file(const std::string& path);
std::string read_text(const std::string& path);

// Whether the folder has an optional part; says on stderr what its absence means.
bool has_part(const std::string& folder, const std::string& name, const std::string& channel);

}  // namespace gastronaut

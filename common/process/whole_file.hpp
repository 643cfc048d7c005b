// Files that are never half a file.
#pragma once

#include <fstream>
#include <functional>
#include <string>

namespace gastronaut {

// Has write(file) fill path + ".partial", waits until that is on the disk and renames it to `path`,
// so that `path` is never half a file, not even after a power cut. Throws std::runtime_error,
// saying why, when that fails; then `path` is what it was.
void write_whole(const std::string& path, const std::function<void(std::ofstream&)>& write);

}  // namespace gastronaut

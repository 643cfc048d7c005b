#include "process/whole_file.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <stdexcept>
#include <system_error>

namespace gastronaut {
namespace {

void sync_file(const std::string& path) {
  const int handle = open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (handle < 0) return;
  fsync(handle);
  close(handle);
}

}  // namespace

void write_whole(const std::string& path, const std::function<void(std::ofstream&)>& write) {
  const std::string partial = path + ".partial";
  std::ofstream file(partial, std::ios::binary | std::ios::trunc);
  if (file) write(file);
  file.close();
  std::error_code error;
  if (file) {
    // Without this a power cut may leave the new name with nothing behind it.
    sync_file(partial);
    std::filesystem::rename(partial, path, error);
  }
  if (!file || error) {
    const std::string why = error ? error.message() : std::strerror(errno);
    std::filesystem::remove(partial, error);
    throw std::runtime_error(path + ": cannot be written (" + why +
                             "); check the folder, its permissions and the space left");
  }
}

}  // namespace gastronaut

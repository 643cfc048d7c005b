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

// Has the kernel write a file or folder to the disk; false, with errno, when it cannot.
bool is_on_disk(const std::string& path) {
  const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) return false;
  const bool done = ::fsync(descriptor) == 0;
  const int why = errno;
  ::close(descriptor);
  errno = why;
  return done;
}

}  // namespace

void write_whole(const std::string& path, const std::function<void(std::ofstream&)>& write) {
  const std::string partial = path + ".partial";
  std::ofstream file(partial, std::ios::binary | std::ios::trunc);
  if (file) write(file);
  file.close();
  // A power cut may not find the new name before the bytes: the file first, then the folder.
  const bool written = file && is_on_disk(partial);
  const int cause = errno;
  std::error_code error;
  if (written) std::filesystem::rename(partial, path, error);
  if (!written || error) {
    const std::string why = error ? error.message() : std::strerror(cause);
    std::filesystem::remove(partial, error);
    throw std::runtime_error(path + ": cannot be written (" + why +
                             "); check the folder, its permissions and the space left");
  }
  // Some file systems know no fsync of a folder; the file is whole there all the same.
  const std::string folder = std::filesystem::path(path).parent_path().string();
  static_cast<void>(is_on_disk(folder.empty() ? "." : folder));
}

}  // namespace gastronaut

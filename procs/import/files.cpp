#include "import/files.hpp"

#include <spdlog/spdlog.h>

#include <filesystem>
#include <fstream>
#include <stdexcept>

namespace gastronaut {
namespace {

template <class Bytes>
Bytes read(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error(path + ": cannot be opened");
  if (!std::filesystem::is_regular_file(path)) throw std::runtime_error(path + ": is not a file");
  Bytes bytes(std::filesystem::file_size(path), 0);
  file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  if (!file) throw std::runtime_error(path + ": cannot be read");
  return bytes;
}

}  // namespace

std::vector<std::uint8_t> read_file(const std::string& path) {
  return read<std::vector<std::uint8_t>>(path);
}

std::string read_text(const std::string& path) { return read<std::string>(path); }

bool has_part(const std::string& folder, const std::string& name, const std::string& channel) {
  if (std::filesystem::exists(folder + "/" + name)) return true;
  spdlog::info("{} has no {}: no {}", folder, name, channel);
  return false;
}

}  // namespace gastronaut

#include "visual_slam/ply_file.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <stdexcept>
#include <system_error>

namespace gastronaut::slam {

static_assert(std::endian::native == std::endian::little);

void write_whole(const std::string& path, const std::function<void(std::ofstream&)>& write) {
  const std::string partial = path + ".partial";
  std::ofstream file(partial, std::ios::binary | std::ios::trunc);
  if (file) write(file);
  file.close();
  std::error_code error;
  if (file) std::filesystem::rename(partial, path, error);
  if (!file || error) {
    const std::string why = error ? error.message() : std::strerror(errno);
    std::filesystem::remove(partial, error);
    throw std::runtime_error(path + ": cannot be written (" + why +
                             "); check the folder, its permissions and the space left");
  }
}

void write_ply_head(std::ofstream& file, const std::string& comment, std::size_t vertices) {
  file << "ply\nformat binary_little_endian 1.0\ncomment " << comment << "\nelement vertex "
       << vertices << '\n';
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) {
    file << "property float " << name << '\n';
  }
  for (const char* name : {"red", "green", "blue"}) file << "property uchar " << name << '\n';
}

void write_ply_vertex(std::ofstream& file, const Eigen::Vector3f& position,
                      const Eigen::Vector3f& normal, float albedo) {
  const auto grey = static_cast<char>(
      static_cast<std::uint8_t>(std::lround(std::clamp(albedo, 0.0F, 1.0F) * 255)));
  const std::array<char, 3> colour = {grey, grey, grey};
  file.write(reinterpret_cast<const char*>(position.data()), sizeof(float) * 3);
  file.write(reinterpret_cast<const char*>(normal.data()), sizeof(float) * 3);
  file.write(colour.data(), sizeof colour);
}

}  // namespace gastronaut::slam

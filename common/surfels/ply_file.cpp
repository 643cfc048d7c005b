#include "surfels/ply_file.hpp"

#include <bit>

namespace gastronaut {

static_assert(std::endian::native == std::endian::little);

void write_ply_head(std::ofstream& file, const std::string& comment, std::size_t vertices) {
  file << "ply\nformat binary_little_endian 1.0\ncomment " << comment << "\nelement vertex "
       << vertices << '\n';
  for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) {
    file << "property float " << name << '\n';
  }
  for (const char* name : {"red", "green", "blue"}) file << "property uchar " << name << '\n';
}

void write_ply_vertex(std::ofstream& file, const Eigen::Vector3f& position,
                      const Eigen::Vector3f& normal, const std::array<std::uint8_t, 3>& colour) {
  file.write(reinterpret_cast<const char*>(position.data()), sizeof(float) * 3);
  file.write(reinterpret_cast<const char*>(normal.data()), sizeof(float) * 3);
  file.write(reinterpret_cast<const char*>(colour.data()),
             static_cast<std::streamsize>(colour.size()));
}

}  // namespace gastronaut

#include "surfels/surfel_file.hpp"

#include <bit>
#include <fstream>

#include "process/whole_file.hpp"

namespace gastronaut {

static_assert(std::endian::native == std::endian::little);

void write_surfels(const std::string& path, std::span<const Surfel> surfels,
                   const std::string& comment) {
  write_whole(path, [&](std::ofstream& file) {
    file << "ply\nformat binary_little_endian 1.0\ncomment metres, " << comment
         << "\nelement vertex " << surfels.size() << "\n";
    for (const char* name : {"x", "y", "z", "nx", "ny", "nz"}) {
      file << "property float " << name << "\n";
    }
    for (const char* name : {"red", "green", "blue"}) file << "property uchar " << name << "\n";
    file << "property float radius\nproperty float confidence\nend_header\n";
    const auto write = [&file](const auto* values, std::size_t bytes) {
      file.write(reinterpret_cast<const char*>(values), static_cast<std::streamsize>(bytes));
    };
    for (const Surfel& surfel : surfels) {
      write(surfel.position.data(), 3 * sizeof(float));
      write(surfel.normal.data(), 3 * sizeof(float));
      write(surfel.colour.data(), surfel.colour.size());
      write(&surfel.radius, sizeof(float));
      write(&surfel.confidence, sizeof(float));
    }
  });
}

}  // namespace gastronaut

#include "surfels/surfel_file.hpp"

#include <array>
#include <fstream>

#include "process/whole_file.hpp"
#include "surfels/ply_file.hpp"

namespace gastronaut {

void write_surfels(const std::string& path, std::span<const Surfel> surfels,
                   const std::string& comment) {
  write_whole(path, [&](std::ofstream& file) {
    write_ply_head(file, "metres, " + comment, surfels.size());
    file << "property float radius\nproperty float confidence\nend_header\n";
    for (const Surfel& surfel : surfels) {
      write_ply_vertex(file, surfel.position, surfel.normal, surfel.colour);
      const std::array<float, 2> rest = {surfel.radius, surfel.confidence};
      file.write(reinterpret_cast<const char*>(rest.data()), sizeof rest);
    }
  });
}

}  // namespace gastronaut

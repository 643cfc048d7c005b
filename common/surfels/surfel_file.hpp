// Surfels as a PLY file for other programs.
#pragma once

#include <span>
#include <string>

#include "surfels/surfel_store.hpp"

namespace gastronaut {

// Little endian: x y z nx ny nz, red green blue, radius confidence. `comment` says what the file
// holds. Throws std::runtime_error.
void write_surfels(const std::string& path, std::span<const Surfel> surfels,
                   const std::string& comment);

}  // namespace gastronaut

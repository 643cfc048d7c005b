// What the writers of PLY files of surfels share.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <string>

namespace gastronaut {

// A PLY header down to the vertices' properties: float x y z nx ny nz, uchar red green blue.
void write_ply_head(std::ofstream& file, const std::string& comment, std::size_t vertices);
// One such vertex.
void write_ply_vertex(std::ofstream& file, const Eigen::Vector3f& position,
                      const Eigen::Vector3f& normal, const std::array<std::uint8_t, 3>& colour);

}  // namespace gastronaut

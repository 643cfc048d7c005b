// What the writers of PLY files share.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <fstream>
#include <string>

namespace gastronaut::slam {

// A PLY header down to the vertices' properties: float x y z nx ny nz, uchar red green blue.
void write_ply_head(std::ofstream& file, const std::string& comment, std::size_t vertices);
// One such vertex; the colour is albedo (0 to 1) as grey.
void write_ply_vertex(std::ofstream& file, const Eigen::Vector3f& position,
                      const Eigen::Vector3f& normal, float albedo);

}  // namespace gastronaut::slam

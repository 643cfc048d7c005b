// What the writers of maps and of PLY files share.
#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <fstream>
#include <functional>
#include <string>

namespace gastronaut::slam {

// Has write(file) fill path + ".partial" and renames it to `path`, so that `path` is never half a
// file. Throws std::runtime_error, saying why, when that fails; then `path` is what it was.
void write_whole(const std::string& path, const std::function<void(std::ofstream&)>& write);

// A PLY header down to the vertices' properties: float x y z nx ny nz, uchar red green blue.
void write_ply_head(std::ofstream& file, const std::string& comment, std::size_t vertices);
// One such vertex; the colour is albedo (0 to 1) as grey.
void write_ply_vertex(std::ofstream& file, const Eigen::Vector3f& position,
                      const Eigen::Vector3f& normal, float albedo);

}  // namespace gastronaut::slam

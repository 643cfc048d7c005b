// A map's surfels on disk, kept between runs.
#pragma once

#include <string>
#include <vector>

#include "geometry/se3.hpp"
#include "visual_slam/surfel_arrays.hpp"

namespace gastronaut::slam {

struct KeptMap {
  SurfelArrays surfels;
  std::vector<SE3> viewpoints;  // map_T_camera of keyframes: from where it is recognised
  // What depth was multiplied by for it to be metric; 0: the map is not in the rig's frame yet.
  double depth_scale = 0;
};

// Little endian: magic "GNSURFEL", uint32 version, uint32 number of viewpoints, uint64 number of
// entries, uint64 checksum (FNV-1a over the payload's 32-bit words), then SurfelArrays' arrays one
// after the other, then the viewpoints as double x y z qw qx qy qz, then double depth_scale. Ids
// are kept. Loading gives back the same bytes. Writes path + ".partial" and renames it when it is
// complete, so that `path` is never half a file; throws std::runtime_error, saying why, when that
// fails.
void save_map(const std::string& path, const KeptMap& map);

// Throws std::runtime_error, saying what is wrong and what to do, for what save_map did not write
// or no longer is what it wrote.
KeptMap load_map(const std::string& path);

}  // namespace gastronaut::slam

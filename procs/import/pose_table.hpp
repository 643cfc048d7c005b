// Camera trajectories as text, in the three formats that recordings come with:
//   TUM     8 columns: time tx ty tz qx qy qz qw
//   KITTI   12 columns: the upper three rows of world_T_camera, one line a frame
//   Open3D  blocks of five lines: three frame numbers, then world_T_camera as 4x4
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "geometry/se3.hpp"
#include "import/issues.hpp"

namespace gastronaut {

struct PoseRow {
  double time = 0;  // seconds, or the frame's number
  SE3 world_T_camera;
  std::size_t line = 0;  // in the file, from 1
};

struct PoseTable {
  bool by_frame = false;  // time is the number of the frame (KITTI, Open3D)
  std::vector<PoseRow> poses;
};

// The format is told from the first row. Rows that are not rigid transforms are left out.
PoseTable parse_pose_table(std::string_view text, const std::string& name, Issues& issues);

}  // namespace gastronaut

// A video, or a folder of numbered pictures, with whatever was recorded beside it.
#pragma once

#include <string>

#include "import/recording.hpp"

namespace gastronaut {

// Empty: there is none. Times in the tables are seconds from the first frame.
struct VideoFiles {
  std::string pictures;  // a video or a folder of numbered pictures
  std::string depth;     // a folder of depth pictures with the same numbers, as a sensor sees it
  std::string hall;      // time, then every channel of the rig's Hall array in tesla
  std::string coils;     // time, then the current of every coil in ampere
  std::string poses;     // true rig_T_camera: TUM, KITTI or Open3D's .log
  double depth_relative_std = 0;
  double rate = 0;  // frames a second; 0: the video's own, or the configuration's for a folder
};

// Throws std::runtime_error for what is missing or cannot be read.
Recording open_video_recording(const VideoFiles& files, const RigConfiguration& rig, double epoch,
                               Issues& issues);

}  // namespace gastronaut

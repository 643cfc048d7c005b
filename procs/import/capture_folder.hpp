// Capture folders: calib.yaml, rgb/NNNNNN.jpg, hall.csv, coils.csv, and for evaluation
// groundtruth.txt and depth/NNNNNN.png. SI units, times in seconds from the start, frame N at
// N / rate. Pictures and depth as the lens sees them; depth along the optical axis, 0 = none.
#pragma once

#include <string>
#include <vector>

#include "import/recording.hpp"

namespace gastronaut {

struct ConfigurationOverrides {
  std::vector<std::string> files;     // parts of a rig's configuration, later ones win
  std::vector<std::string> settings;  // "a.b=c"
};

// The rig that a calib.yaml describes. Throws ConfigurationError.
RigConfiguration read_capture_calibration(const std::string& path);

// Throws std::runtime_error for files that are missing, ConfigurationError for calib.yaml and the
// overrides.
Recording open_capture_folder(const std::string& folder, const ConfigurationOverrides& overrides,
                              double epoch, Issues& issues);

}  // namespace gastronaut

// A recording as the trials need it: depth, albedo, luminance and true pose of each frame.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "configuration/rig_configuration.hpp"
#include "geometry/se3.hpp"
#include "visual_slam/frame_assembly.hpp"
#include "visual_slam/visual_slam.hpp"

namespace gastronaut::slam {

enum class DepthChannel { kOwn, kTruth };          // DEPTH; GROUND_TRUTH_DEPTH
enum class ColourChannel { kAlbedo, kLuminance };  // ALBEDO; CAMERA, undistorted

struct RecordingOptions {
  std::string log;
  DepthChannel depth = DepthChannel::kOwn;
  double truth_relative_std = 0.001;             // what true depth is said to be uncertain by
  std::vector<std::string> configuration_files;  // laid over the log's own RIG_CONFIG
  std::vector<std::string> settings;
};

struct RecordedFrame {
  std::int64_t utime = 0;
  DepthCounts depth;
  std::optional<AlbedoLevels> albedo;
  std::optional<AlbedoLevels> luminance;
  PictureHealth health;
  std::optional<SE3> rig_T_camera;  // the truth

  const AlbedoLevels& colour(ColourChannel channel) const {
    return channel == ColourChannel::kAlbedo ? albedo.value() : luminance.value();
  }
};

struct Recording {
  RigConfiguration configuration;
  std::vector<RecordedFrame> frames;  // in the order of time
  bool has_albedo = false;            // all frames have it
  bool has_luminance = false;
};

// The frames with depth and with albedo or luminance. Throws std::runtime_error, saying what is
// missing, where there is nothing to track or no truth to compare with, and ConfigurationError.
Recording read_recording(const RecordingOptions& options);

}  // namespace gastronaut::slam

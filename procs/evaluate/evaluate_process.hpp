// Reads a derived log into what the evaluation needs, and is with picture_process the only part of
// it that knows channels and LCM types. Pictures are compared as they come and not kept.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "configuration/rig_configuration.hpp"
#include "evaluate/depth_errors.hpp"
#include "evaluate/map_deformations.hpp"
#include "evaluate/pose_channel.hpp"
#include "evaluate/sensor_failures.hpp"
#include "evaluate/trajectory.hpp"
#include "surfels/surfel_store.hpp"

namespace gastronaut::evaluation {

struct ChannelCount {
  std::size_t messages = 0;
  std::uint64_t bytes = 0;
  std::size_t corrupt = 0;  // damaged, or of another type than the channel's
};

struct HallReading {
  std::int64_t utime = 0;
  std::vector<int> unusable_channels;  // by status or saturation; ascending
};

struct DepthFrame {
  std::int64_t utime = 0;
  DepthErrors errors;
};

struct DepthSeries {
  std::vector<DepthFrame> frames;
  DepthProfile profile;  // of all frames
};

struct MapSize {
  std::int64_t utime = 0;
  std::size_t surfels = 0;
  std::size_t stable = 0;
};

struct MapRecord {
  std::vector<Surfel> surfels;  // after the last message, by id
  std::vector<MapSize> sizes;   // after each message
  std::vector<MapDeformation> deformations;
  std::size_t refused = 0;   // surfels that were none
  std::int32_t version = 0;  // of the last message
  // visual_slam.stable_confidence: from it on a surfel is part of the map.
  double stable_confidence = VisualSlamConfiguration{}.stable_confidence;
};

struct RecordedRun {
  std::optional<RigConfiguration> configuration;
  std::string configuration_name;
  std::string code_version;  // of the program that wrote RIG_CONFIG
  std::map<std::string, ChannelCount> channels;
  std::int64_t first_utime = 0;  // recorded time, microseconds
  std::int64_t last_utime = 0;
  std::string damage;                      // of the log, with its offset; empty: none
  TruthTrack truth;                        // rig_T_camera
  std::vector<PoseChannel> pose_channels;  // those with messages
  SensorHealthSeries sensor_health;
  std::vector<HallReading> hall_readings;
  DepthSeries depth;
  MapRecord map;
  // With CAMERA, DEPTH, ALBEDO or VESSELS, ascending; a frame's number counts them from 0.
  std::vector<std::int64_t> frame_utimes;
  std::map<std::string, std::size_t> failures;  // of pictures, as ALBEDO names them
  std::vector<std::string> notes;               // what could not be used, and why
};

// `progress` gets the fraction that is read. Throws std::runtime_error when the log cannot be
// opened or holds no message at all.
RecordedRun read_run(const std::string& path, const std::function<void(double)>& progress);

}  // namespace gastronaut::evaluation

// Writes a report folder: metrics.json, trajectories, CSV series, and by way of report.py the plots
// and index.html.
#pragma once

#include <span>
#include <string>

#include "evaluate/evaluate_process.hpp"
#include "evaluate/metrics.hpp"
#include "evaluate/pose_channel.hpp"

namespace gastronaut::evaluation {

// The bound of each Hall reading with truth.
struct BoundSample {
  std::int64_t utime = 0;
  double position = 0;  // metres, square root of the trace
  double axis = 0;      // radians, likewise
  double position_sensor_noise_only = 0;
  double axis_sensor_noise_only = 0;
};

// All of these throw std::runtime_error when a file cannot be written.
void write_metrics(const std::string& path, const Metrics& metrics);
// One row a fix; bounds of the same utime in its last columns. utimes ascending in both.
void write_pose_series(const std::string& path, const PoseChannel& channel,
                       const PoseEvaluation& evaluation, std::span<const BoundSample> bounds);
// One row a sensor of each CAPSULE_STATE.
void write_sensor_health(const std::string& path, const SensorHealthSeries& health);
void write_truth_series(const std::string& path, const TruthTrack& truth);
// One row a frame, and one row a bin of true distance.
void write_depth_series(const std::string& folder, const DepthSeries& depth);

// What replay measured of the processes, from DERIVED.lcmlog.timing.json; false: no such file.
bool set_timing_metrics(Metrics& metrics, const std::string& path);

// Draws the plots of a folder with the files above and writes its index.html. `surface`: a PLY file
// drawn with the trajectories, or empty. Throws std::runtime_error that says what is missing.
void draw_report(const std::string& folder, const std::string& surface);

}  // namespace gastronaut::evaluation

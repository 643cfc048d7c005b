// Readers for the shared magnetometer recordings, and what a fix is compared with.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "configuration/rig_configuration.hpp"
#include "magnetic_localizer/sensor_array.hpp"

namespace gastronaut::test {

struct TrueMagnet {
  Eigen::Vector3d position;
  Eigen::Vector3d axis;
};

struct RecordedReading {
  double time = 0;  // seconds
  magnetics::HallReading hall;
  std::optional<Eigen::VectorXd> currents;
  std::optional<TrueMagnet> truth;
};

struct Recording {
  RigConfiguration rig;
  std::vector<RecordedReading> readings;
};

// The shared data; nothing where it is absent.
std::optional<std::filesystem::path> shared_data();

// A capture folder: the Hall readings at the times of its ground truth.
Recording read_capture(const std::filesystem::path& folder);

// Run 1, 2 or 3 of the 16-sensor board, turned so that its plane is the rig's xy plane with the
// magnet below.
Recording read_magnet_board(const std::filesystem::path& folder, int run);

// One file of the 10-sensor recordings (no truth, no calibration).
Recording read_magnetometer_10(const std::filesystem::path& file);

}  // namespace gastronaut::test

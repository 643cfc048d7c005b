// A capture folder made from physics: a dipole carried past two by two Hall sensors over two coils,
// a camera that looks at a wall.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "import_fixtures.hpp"

namespace gastronaut {

struct SyntheticCapture {
  static constexpr int kWidth = 48;
  static constexpr int kHeight = 32;
  static constexpr int kFrames = 6;
  static constexpr double kFrameRate = 20;
  static constexpr int kReadings = 30;
  static constexpr double kHallRate = 100;
  static constexpr std::size_t kChannels = 12;
  static constexpr std::size_t kCoils = 2;
  static constexpr double kWall = 0.04;  // metres from the camera, across its axis
  static constexpr double kMetresPerCount = 1e-5;

  // Writes the folder.
  explicit SyntheticCapture(const ScratchFolder& folder);

  // What was written, before it was rounded to text.
  std::vector<Eigen::VectorXd> hall;      // tesla
  std::vector<Eigen::VectorXd> currents;  // ampere
  std::vector<Eigen::Vector3d> camera;    // metres, rig frame; turned by half about x
  std::vector<std::vector<std::uint8_t>> pictures;
};

// A channel's text in hall.csv: this many significant digits.
constexpr double kPrintedRelative = 1e-9;

}  // namespace gastronaut

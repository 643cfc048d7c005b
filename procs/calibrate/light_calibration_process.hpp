// `calibrate light`: its command line, what it reads of the log, what it hands back.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calibrate/light_calibration.hpp"

namespace CLI {
class App;
}

namespace gastronaut {

struct LightCommand {
  std::string log;
  std::vector<std::string> configuration_files;
  std::vector<std::string> settings;
  std::string geometry = "auto";
  int most_pictures = 120;
  std::optional<double> albedo;
  int response_knots = 0;
  std::vector<std::string> held;
  double position_std = 1e-4;  // metres, of poses
  double angle_std = 1e-3;     // radians
};

// The options that `calibrate light` has beside LOG, --out, --config and --set.
void add_light_options(CLI::App& command, LightCommand& options);

struct LightCalibrationTexts {
  std::string fragment;
  std::string table;
};
// Throws ConfigurationError, CalibrationRefused, std::runtime_error.
LightCalibrationTexts run_light_calibration(const LightCommand& options);

}  // namespace gastronaut

// `calibrate hand-eye`: its command line, what it reads of the log, what it hands back.
#pragma once

#include <string>
#include <vector>

namespace CLI {
class App;
}

namespace gastronaut {

struct HandEyeCommand {
  std::string log;
  std::vector<std::string> configuration_files;
  std::vector<std::string> settings;
};

// What `calibrate hand-eye` says of itself in --help.
void describe_hand_eye(CLI::App& command);

struct HandEyeTexts {
  std::string fragment;
  std::string table;
};
// Throws ConfigurationError, CalibrationRefused, std::runtime_error.
HandEyeTexts run_hand_eye_calibration(const HandEyeCommand& command);

}  // namespace gastronaut

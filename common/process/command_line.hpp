// What every program's command line has in common: --version, --help, exit statuses, signals,
// logging to stderr.
#pragma once

#include <atomic>
#include <functional>
#include <string>
#include <vector>

namespace CLI {
class App;
}

namespace gastronaut {

inline constexpr int kExitDone = 0;
inline constexpr int kExitFailed = 1;  // while running
inline constexpr int kExitUsage = 2;   // wrong usage or configuration

// --config FILE... and --set key=value...
void add_configuration_options(CLI::App& app, std::vector<std::string>& files,
                               std::vector<std::string>& settings);

// Adds --version, parses, sets up logging and signal handlers, calls `run` and turns what it
// throws into a message on stderr and an exit status: ConfigurationError 2, the rest 1.
int run_command_line(CLI::App& app, int argc, char** argv, const std::function<int()>& run);

// Set by SIGINT and SIGTERM.
const std::atomic<bool>& stop_requested();

}  // namespace gastronaut

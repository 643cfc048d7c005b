#include "process/command_line.hpp"

#include <spdlog/sinks/stdout_color_sinks.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <csignal>

#include "configuration/fields.hpp"
#include "process/version.hpp"

namespace gastronaut {
namespace {

std::atomic<bool> stop{false};
static_assert(std::atomic<bool>::is_always_lock_free, "a signal handler sets it");

void on_signal(int) { stop = true; }

}  // namespace

const std::atomic<bool>& stop_requested() { return stop; }

void add_configuration_options(CLI::App& app, std::vector<std::string>& files,
                               std::vector<std::string>& settings) {
  app.add_option("--config", files,
                 "rig configuration; later files override earlier ones (and a log's own)")
      ->allow_extra_args(false)
      ->check(CLI::ExistingFile);
  app.add_option("--set", settings, "override one value, e.g. --set hall_array.noise=2uT")
      ->allow_extra_args(false);
}

int run_command_line(CLI::App& app, int argc, char** argv, const std::function<int()>& run) {
  app.set_version_flag("--version", app.get_name() + " " + code_version());
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? kExitDone : kExitUsage;
  }
  spdlog::drop(app.get_name());  // of an earlier call in the same program, as tests make them
  auto logger = spdlog::stderr_color_mt(app.get_name());
  logger->set_pattern("%^%l%$ %n: %v");
  spdlog::set_default_logger(std::move(logger));
  struct sigaction action {};
  action.sa_handler = on_signal;
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  try {
    return run();
  } catch (const ConfigurationError& error) {
    spdlog::error("{}", error.what());
    return kExitUsage;
  } catch (const std::exception& error) {
    spdlog::error("{}", error.what());
    return kExitFailed;
  }
}

}  // namespace gastronaut

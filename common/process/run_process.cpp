#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "bus/host_check.hpp"
#include "bus/lcm_bus.hpp"
#include "numerics/parallel.hpp"
#include "process/command_line.hpp"
#include "process/log_run.hpp"
#include "process/process.hpp"
#include "process/progress.hpp"
#include "process/status_reporter.hpp"
#include "process/version.hpp"

namespace gastronaut {
namespace {

struct Options {
  LogRunOptions log;
  std::string lcm_url;
  int threads = 0;
};

int run_live(const ProcessDescription& description, const Options& options) {
  if (options.log.configuration_files.empty()) {
    throw ConfigurationError("live running needs the rig's configuration: --config FILE");
  }
  const RigConfiguration configuration =
      load_rig_configuration(options.log.configuration_files, options.log.settings);
  const std::string url = resolve_lcm_url(options.lcm_url);
  for (const std::string& problem : check_host(url)) spdlog::warn("{}", problem);
  LcmBus bus(url);
  const std::unique_ptr<Process> process = description.create(bus, configuration);
  StatusReporter reporter(bus, description.name);
  spdlog::info("running on {}", url);
  bus.run(stop_requested(), [&reporter] { reporter.tick(); });
  bus.drain();
  process->finish();
  spdlog::info("stopped: received {}, published {}, late {}, lost {}, corrupt {}, foreign {}",
               bus.counters().received, bus.counters().published, bus.counters().late,
               bus.counters().lost, bus.counters().corrupt, bus.counters().foreign);
  return kExitDone;
}

int run_log(const ProcessDescription& description, const Options& options) {
  Progress progress(description.name);
  const LogRunResult result =
      run_on_log({description}, options.log, [&progress](double f) { progress.update(f); });
  if (!result.damage.empty()) spdlog::warn("{}; everything before it was used", result.damage);
  const ProcessTiming& timing = result.processes.front();
  if (!timing.health.empty()) spdlog::warn("{}", timing.health);
  spdlog::info("{} events in, {} messages out, {:.1f} s of log in {:.1f} s", result.events_read,
               result.messages_derived, result.log_seconds, result.wall_seconds);
  return kExitDone;
}

}  // namespace

int run_process(int argc, char** argv, const ProcessDescription& description) {
  CLI::App app(description.summary + "\n\nLive:     " + description.name +
                   " --config config/rigs/lab.yaml\nOn a log: " + description.name +
                   " --log-in raw.lcmlog --log-out derived.lcmlog",
               description.name);
  Options options;
  add_configuration_options(app, options.log.configuration_files, options.log.settings);
  app.add_option("--lcm-url", options.lcm_url,
                 std::string("LCM URL; default: $LCM_DEFAULT_URL, else ") + kDefaultLcmUrl);
  auto* in = app.add_option("--log-in", options.log.log_in, "run on this log instead of live");
  auto* out = app.add_option("--log-out", options.log.log_out, "where the derived log goes");
  in->needs(out);
  out->needs(in);
  app.add_option("--threads", options.threads, "threads to use; default: one a core")
      ->check(CLI::NonNegativeNumber);
  if (description.add_options) description.add_options(app);
  return run_command_line(app, argc, argv, [&] {
    set_thread_count(options.threads);
    return options.log.log_in.empty() ? run_live(description, options)
                                      : run_log(description, options);
  });
}

}  // namespace gastronaut

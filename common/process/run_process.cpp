#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <array>
#include <chrono>
#include <memory>

#include "bus/host_check.hpp"
#include "bus/lcm_bus.hpp"
#include "bus/wall_clock.hpp"
#include "numerics/parallel.hpp"
#include "process/channels.hpp"
#include "process/command_line.hpp"
#include "process/log_run.hpp"
#include "process/process.hpp"
#include "process/progress.hpp"
#include "process/usage.hpp"
#include "process/version.hpp"

namespace gastronaut {
namespace {

// Fills PROCESS_STATUS once a second.
class StatusReporter {
 public:
  StatusReporter(LcmBus& bus, const std::string& name) : bus_(bus) {
    status_.name = name;
    std::array<char, 256> host{};
    gethostname(host.data(), host.size() - 1);
    status_.host = host.data();
    status_.pid = getpid();
  }

  void tick() {
    const auto now = std::chrono::steady_clock::now();
    const double elapsed = std::chrono::duration<double>(now - last_).count();
    if (elapsed < 1) return;
    report(elapsed);
    last_ = now;
  }

 private:
  void report(double elapsed) {
    const double cpu = cpu_seconds();
    const BusCounters& counters = bus_.counters();
    const LcmBus::Latency latency = bus_.latency();
    status_.utime = wall_utime();
    status_.state = static_cast<std::int8_t>(bus_.state());
    status_.message = bus_.describe_health();
    status_.received = counters.received;
    status_.published = counters.published;
    status_.dropped = counters.dropped;
    status_.late = counters.late;
    status_.lost = counters.lost;
    status_.latency_p50 = latency.p50;
    status_.latency_p99 = latency.p99;
    status_.cpu = (cpu - last_cpu_) / elapsed;
    status_.resident_bytes = resident_bytes();
    last_cpu_ = cpu;
    bus_.publish_status(channel::kProcessStatus, status_);
  }

  LcmBus& bus_;
  process_status_t status_{};
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
  double last_cpu_ = 0;
};

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

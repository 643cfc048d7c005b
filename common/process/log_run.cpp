#include "process/log_run.hpp"

#include <algorithm>
#include <chrono>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>

#include "bus/log_file.hpp"
#include "bus/memory_bus.hpp"
#include "process/channels.hpp"
#include "process/rig_config_message.hpp"
#include "process/usage.hpp"

namespace gastronaut {
namespace {

using Clock = std::chrono::steady_clock;

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

std::optional<rig_config_t> find_rig_config(const std::string& path) {
  LogReader reader(path);
  while (const auto event = reader.next()) {
    rig_config_t message;
    if (event->channel == channel::kRigConfig &&
        decode_message(event->payload, message) == DecodeResult::kOk) {
      return message;
    }
  }
  return std::nullopt;
}

RigConfiguration configuration_for(const LogRunOptions& options) {
  const auto recorded = find_rig_config(options.log_in);
  if (!recorded && options.configuration_files.empty()) {
    throw ConfigurationError(options.log_in +
                             ": has no readable RIG_CONFIG; give the rig's file with --config");
  }
  return parse_rig_configuration(recorded ? recorded->yaml : "", options.log_in + " (RIG_CONFIG)",
                                 options.settings, options.configuration_files);
}

double quantile(const std::vector<double>& sorted, double q) {
  if (sorted.empty()) return 0;
  return sorted[static_cast<std::size_t>(q * static_cast<double>(sorted.size() - 1))];
}

}  // namespace

LogRunResult run_on_log(const std::vector<ProcessDescription>& descriptions,
                        const LogRunOptions& options, const std::function<void(double)>& progress) {
  const Clock::time_point start = Clock::now();
  const RigConfiguration configuration = configuration_for(options);
  LogReader reader(options.log_in);
  LogWriter writer(options.log_out);
  LogRunResult result;
  std::int64_t log_utime = 0;

  MemoryNetwork network([&](const std::string& channel, Bytes payload, std::int64_t) {
    writer.write(channel, payload, log_utime);
    ++result.messages_derived;
  });
  std::map<std::string, std::string> replaced;  // channel: its process's source
  std::set<std::string> seen;
  std::vector<std::unique_ptr<Process>> processes;
  std::vector<Bus*> buses;
  std::vector<std::vector<double>> durations(descriptions.size());
  for (const ProcessDescription& description : descriptions) {
    for (const std::string& output : description.outputs(configuration)) {
      replaced[output] = description.source;
    }
    buses.push_back(&network.connect());
    processes.push_back(description.create(*buses.back(), configuration));
  }
  Clock::time_point event_start;
  network.before_event = [&](std::size_t) { event_start = Clock::now(); };
  network.after_event = [&](std::size_t process) {
    durations[process].push_back(milliseconds_since(event_start));
  };

  bool configuration_written = false;
  const auto write_configuration_message = [&](std::int64_t utime) {
    writer.write(channel::kRigConfig, encode_message(rig_config_message(configuration, utime)),
                 log_utime);
    configuration_written = true;
  };
  std::optional<std::int64_t> first_log_utime;
  while (const auto event = reader.next()) {
    ++result.events_read;
    log_utime = event->log_utime;
    if (!first_log_utime) first_log_utime = log_utime;
    if (event->channel == channel::kRigConfig) {
      // What was really in force here may differ from what was recorded: --config, --set.
      rig_config_t recorded;
      if (decode_message(event->payload, recorded) == DecodeResult::kOk) {
        write_configuration_message(recorded.utime);
      }
      continue;
    }
    if (!configuration_written) write_configuration_message(log_utime);
    seen.insert(event->channel);
    const auto output = replaced.find(event->channel);
    const bool derived_anew = output != replaced.end() && seen.contains(output->second);
    if (derived_anew || event->channel == channel::kProcessStatus) continue;
    if (options.keep_images || event->channel != channel::kCamera) {
      writer.write(event->channel, event->payload, log_utime);
    }
    network.inject(event->channel, event->payload);
    network.run_until_idle();
    if (progress) {
      progress(static_cast<double>(reader.offset()) / static_cast<double>(reader.size()));
    }
  }
  network.finish([&processes](std::size_t i) { processes[i]->finish(); });
  writer.close();

  result.damage = reader.damage();
  result.log_seconds =
      first_log_utime ? static_cast<double>(log_utime - *first_log_utime) * 1e-6 : 0;
  result.wall_seconds = std::chrono::duration<double>(Clock::now() - start).count();
  result.cpu_seconds = cpu_seconds();
  result.peak_resident_bytes = peak_resident_bytes();
  for (std::size_t i = 0; i < descriptions.size(); ++i) {
    std::vector<double>& sorted = durations[i];
    std::sort(sorted.begin(), sorted.end());
    ProcessTiming timing;
    timing.name = descriptions[i].name;
    timing.events = static_cast<std::int64_t>(sorted.size());
    timing.ms_median = quantile(sorted, 0.5);
    timing.ms_p99 = quantile(sorted, 0.99);
    timing.ms_max = quantile(sorted, 1);
    timing.counters = buses[i]->counters();
    timing.health = buses[i]->describe_health();
    result.processes.push_back(std::move(timing));
  }
  return result;
}

}  // namespace gastronaut

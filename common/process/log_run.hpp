// Processes on a log: one process with --log-in and --log-out, or all of them in `replay`.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "process/process.hpp"

namespace gastronaut {

struct LogRunOptions {
  std::string log_in;
  std::string log_out;
  std::vector<std::string> configuration_files;  // laid over the log's own RIG_CONFIG, key by key
  std::vector<std::string> settings;
  bool keep_images = true;  // carry CAMERA along into log_out
};

struct ProcessTiming {
  std::string name;
  std::int64_t events = 0;
  double ms_median = 0;
  double ms_p99 = 0;
  double ms_max = 0;
  BusCounters counters;
  std::string health;
};

struct LogRunResult {
  std::int64_t events_read = 0;
  std::int64_t messages_derived = 0;
  double log_seconds = 0;  // span of recorded time
  double wall_seconds = 0;
  double cpu_seconds = 0;
  std::int64_t peak_resident_bytes = 0;
  std::string damage;  // of the input log; empty: none
  std::vector<ProcessTiming> processes;
};

// Feeds every event of log_in to the processes and writes log_out: the input's events (without
// PROCESS_STATUS and without what these processes publish anew, see ProcessDescription::source)
// with the derived ones between them, each recorded at the time of the event that caused it. Bytes
// of log_out depend on log_in, configuration and code only. Throws ConfigurationError and
// std::runtime_error.
LogRunResult run_on_log(const std::vector<ProcessDescription>& processes,
                        const LogRunOptions& options,
                        const std::function<void(double fraction)>& progress);

}  // namespace gastronaut

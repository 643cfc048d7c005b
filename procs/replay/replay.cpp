#include "replay/replay.hpp"

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>

#include "depth_estimator/depth_estimator_process.hpp"
#include "magnetic_localizer/magnetic_localizer_process.hpp"
#include "numerics/parallel.hpp"
#include "occupancy_mapper/occupancy_mapper_process.hpp"
#include "process/command_line.hpp"
#include "process/log_run.hpp"
#include "process/progress.hpp"
#include "sensor_fusion/sensor_fusion_process.hpp"
#include "visual_slam/visual_slam_process.hpp"

namespace gastronaut {
namespace {

// Timings are not repeatable, so they lie beside the derived log, not in it; evaluate reads them.
void write_timing(const std::string& path, const LogRunResult& result, int threads) {
  nlohmann::ordered_json json;
  json["wall_seconds"] = result.wall_seconds;
  json["cpu_seconds"] = result.cpu_seconds;
  json["peak_resident_bytes"] = result.peak_resident_bytes;
  json["threads"] = threads;
  for (const ProcessTiming& timing : result.processes) {
    json["processes"][timing.name] = {{"events", timing.events},
                                      {"ms_median", timing.ms_median},
                                      {"ms_p99", timing.ms_p99},
                                      {"ms_max", timing.ms_max}};
  }
  std::ofstream file(path);
  file << json.dump(2) << "\n";
  if (!file.flush()) throw std::runtime_error(path + ": cannot be written");
}

void print_summary(const LogRunOptions& options, const LogRunResult& result) {
  constexpr double kMegabyte = 1e6;
  std::printf("%s: %.1f s of recording, %lld events in, %lld messages derived\n",
              options.log_out.c_str(), result.log_seconds,
              static_cast<long long>(result.events_read),
              static_cast<long long>(result.messages_derived));
  std::printf("wall %.2f s, CPU %.2f s, peak memory %.0f MB\n", result.wall_seconds,
              result.cpu_seconds, static_cast<double>(result.peak_resident_bytes) / kMegabyte);
  std::printf("%-20s %10s %10s %10s %10s %6s %6s %8s\n", "process", "events", "ms median", "ms p99",
              "ms max", "late", "lost", "corrupt");
  for (const ProcessTiming& timing : result.processes) {
    std::printf("%-20s %10lld %10.3f %10.3f %10.3f %6lld %6lld %8lld\n", timing.name.c_str(),
                static_cast<long long>(timing.events), timing.ms_median, timing.ms_p99,
                timing.ms_max, static_cast<long long>(timing.counters.late),
                static_cast<long long>(timing.counters.lost),
                static_cast<long long>(timing.counters.corrupt + timing.counters.foreign));
    if (!timing.health.empty()) spdlog::warn("{}: {}", timing.name, timing.health);
  }
}

}  // namespace

std::vector<ProcessDescription> all_processes() {
  return {magnetic_localizer_process(), depth_estimator_process(), visual_slam_process(),
          sensor_fusion_process(), occupancy_mapper_process()};
}

std::vector<ProcessDescription> select_processes(const std::string& only) {
  const std::vector<ProcessDescription> all = all_processes();
  if (only.empty()) return all;
  std::vector<std::string> wanted;
  std::istringstream words(only);
  for (std::string word; std::getline(words, word, ',');) wanted.push_back(word);
  std::string known;
  for (const ProcessDescription& process : all) known += (known.empty() ? "" : ", ") + process.name;
  std::vector<ProcessDescription> selected;
  for (const std::string& name : wanted) {
    if (std::none_of(all.begin(), all.end(), [&](const auto& p) { return p.name == name; })) {
      throw ConfigurationError("--only: '" + name + "' is no process; there are: " + known);
    }
  }
  for (const ProcessDescription& process : all) {
    if (std::find(wanted.begin(), wanted.end(), process.name) != wanted.end()) {
      selected.push_back(process);
    }
  }
  return selected;
}

int run_replay(int argc, char** argv) {
  CLI::App app(
      "Runs all processes over a recorded log, as fast as they go, into one derived log.\n"
      "The same log gives the same bytes, whatever the number of threads.\n\n"
      "Example: replay raw.lcmlog --out derived.lcmlog",
      "replay");
  LogRunOptions options;
  options.keep_images = false;
  std::string only;
  int threads = 0;
  app.add_option("log", options.log_in, "the recorded log")->required()->check(CLI::ExistingFile);
  app.add_option("--out", options.log_out, "the derived log")->required();
  app.add_option("--only", only, "processes to run, separated by commas; default: all");
  app.add_flag("--keep-images", options.keep_images, "carry CAMERA along into the derived log");
  app.add_option("--threads", threads, "threads to use; default: one a core")
      ->check(CLI::NonNegativeNumber);
  add_configuration_options(app, options.configuration_files, options.settings);
  return run_command_line(app, argc, argv, [&] {
    const std::vector<ProcessDescription> processes = select_processes(only);
    set_thread_count(threads);
    LogRunResult result;
    {
      Progress progress("replay");
      result = run_on_log(processes, options, [&progress](double f) { progress.update(f); });
    }
    if (!result.damage.empty()) spdlog::warn("{}; everything before it was used", result.damage);
    write_timing(options.log_out + ".timing.json", result, threads);
    print_summary(options, result);
    return kExitDone;
  });
}

}  // namespace gastronaut

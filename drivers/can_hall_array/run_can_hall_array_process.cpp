#include "can_hall_array/run_can_hall_array_process.hpp"

#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <fstream>
#include <memory>
#include <optional>
#include <thread>

#include "bus/host_check.hpp"
#include "bus/lcm_bus.hpp"
#include "bus/log_file.hpp"
#include "bus/memory_bus.hpp"
#include "bus/wall_clock.hpp"
#include "can/can_socket.hpp"
#include "can/candump.hpp"
#include "can_hall_array/can_hall_array_process.hpp"
#include "clock/device_clock.hpp"
#include "process/command_line.hpp"
#include "process/status_reporter.hpp"

namespace gastronaut {
namespace {

struct Options {
  std::vector<std::string> configuration_files;
  std::vector<std::string> settings;
  std::string lcm_url;
  std::string log_out;
  std::string candump;
};

// Where frames come from.
class FrameSource {
 public:
  virtual ~FrameSource() = default;
  // Hands the frames that are there to `process`, or waits a little for some. False at the end.
  virtual bool serve(CanHallArrayProcess& process) = 0;
  // Frames lost because this program was too slow.
  virtual std::int64_t dropped() const { return 0; }
  // Why no frames can come; empty: they can.
  virtual std::string problem() const { return ""; }
};

// A CAN interface, which may go down, vanish and come back.
class SocketSource : public FrameSource {
 public:
  explicit SocketSource(const CanHallArrayConfiguration& configuration)
      : configuration_(configuration) {}

  bool serve(CanHallArrayProcess& process) override {
    try {
      if (!socket_) {
        socket_.emplace(configuration_.interface, process.layout().identifiers());
        clock_ = {};
        process.start_listening();
        spdlog::info("listening on {}", configuration_.interface);
        problem_.clear();
      }
      constexpr double kMostWait = 0.1;  // seconds, so that signals and status are not forgotten
      socket_->wait(std::min(configuration_.timeout, kMostWait));
      // What came before now is in the socket; all of it is taken out before time goes on.
      const std::int64_t now = wall_utime();
      while (auto received = socket_->receive()) {
        if (received->device_utime) {
          received->frame.utime = clock_.to_host(*received->device_utime, received->frame.utime);
        }
        process.handle(received->frame);
        if (received->frame.utime > now) break;  // so that a flood cannot hold up the rest
      }
      process.advance(now);
    } catch (const CanUnavailable& unavailable) {
      if (socket_) dropped_before_ += socket_->dropped();
      socket_.reset();
      problem_ = unavailable.what();
      process.advance(wall_utime());
      constexpr auto kRetry = std::chrono::milliseconds(100);
      std::this_thread::sleep_for(kRetry);
    }
    return true;
  }
  std::int64_t dropped() const override {
    return dropped_before_ + (socket_ ? socket_->dropped() : 0);
  }
  std::string problem() const override { return problem_; }

 private:
  CanHallArrayConfiguration configuration_;
  std::optional<CanSocket> socket_;
  DeviceClock clock_;
  std::int64_t dropped_before_ = 0;
  std::string problem_;
};

// A log that candump wrote, all of it at once or as fast as it was recorded.
class CandumpSource : public FrameSource {
 public:
  CandumpSource(const std::string& path, bool in_real_time)
      : path_(path), file_(path), in_real_time_(in_real_time) {
    if (!file_) throw std::runtime_error(path + ": cannot be read");
  }

  bool serve(CanHallArrayProcess& process) override {
    std::string line;
    if (!std::getline(file_, line)) {
      if (bad_lines_ > 0) spdlog::warn("{}: {} damaged lines left out", path_, bad_lines_);
      return false;
    }
    ++line_number_;
    if (line.empty()) return true;
    CandumpLine parsed;
    try {
      parsed = parse_candump_line(line);
    } catch (const std::invalid_argument& problem) {
      constexpr int kShown = 5;
      if (++bad_lines_ <= kShown) {
        spdlog::warn("{}:{}: {}", path_, line_number_, problem.what());
      }
      return true;
    }
    if (in_real_time_) wait_until(parsed.frame.utime);
    process.handle(parsed.frame);
    return true;
  }

 private:
  void wait_until(std::int64_t utime) {
    using Clock = std::chrono::steady_clock;
    if (!first_utime_) {
      first_utime_ = utime;
      start_ = Clock::now();
    }
    const auto due = start_ + std::chrono::microseconds(utime - *first_utime_);
    constexpr auto kMostSleep = std::chrono::milliseconds(100);  // so that signals are heard
    while (!stop_requested() && Clock::now() < due) {
      std::this_thread::sleep_until(std::min(due, Clock::now() + kMostSleep));
    }
  }

  std::string path_;
  std::ifstream file_;
  bool in_real_time_;
  std::int64_t line_number_ = 0;
  std::int64_t bad_lines_ = 0;
  std::optional<std::int64_t> first_utime_;
  std::chrono::steady_clock::time_point start_;
};

void say_goodbye(const CanHallArrayProcess& process, const FrameSource& source) {
  const CycleAssembler::Counters& field = process.counters(CanStream::kField);
  const CycleAssembler::Counters& currents = process.counters(CanStream::kCurrents);
  const BusMonitor::Counters& bus = process.monitor().counters();
  spdlog::info(
      "{} frames, {} malformed, {} dropped; readings: {} whole, {} incomplete, {} lost; currents: "
      "{} whole, {} incomplete, {} lost; frames twice {}, late {}; error frames {}, bus-off {}, "
      "recovered {}",
      process.frames(), process.malformed(), source.dropped(), field.complete, field.incomplete,
      field.lost, currents.complete, currents.incomplete, currents.lost,
      field.duplicates + currents.duplicates, field.late + currents.late, bus.error_frames,
      bus.bus_offs, bus.recoveries);
}

int run_live(CanHallArrayProcess& process, FrameSource& source, LcmBus& bus) {
  StatusReporter reporter(bus, "can_hall_array");
  std::string said;
  while (!stop_requested() && source.serve(process)) {
    if (!reporter.due()) continue;
    CanHallArrayProcess::Health health = process.report(source.dropped());
    if (!source.problem().empty()) {
      health = {ProcessState::kDegraded, source.problem()};
      said.clear();  // once a second
    }
    if (health.message != said && !health.message.empty()) spdlog::warn("{}", health.message);
    said = health.message;
    BusCounters counters = bus.counters();
    counters.received = process.frames();
    counters.dropped = source.dropped();
    for (const CanStream stream : {CanStream::kField, CanStream::kCurrents}) {
      counters.lost += process.counters(stream).lost;
      counters.late += process.counters(stream).late;
    }
    reporter.tick(counters, health.state, health.message);
  }
  process.finish();
  say_goodbye(process, source);
  return kExitDone;
}

int run_into_log(const RigConfiguration& rig, HallArrayLayout layout, FrameSource& source,
                 const Options& options) {
  LogWriter log(options.log_out);
  MemoryNetwork network([&log](const std::string& channel, Bytes payload, std::int64_t utime) {
    log.write(channel, payload, utime);
  });
  CanHallArrayProcess process(network.connect(), rig, std::move(layout));
  std::string problem;
  while (!stop_requested() && source.serve(process)) {
    if (source.problem() != problem) {
      problem = source.problem();
      if (!problem.empty()) spdlog::warn("{}", problem);
    }
  }
  if (stop_requested() && !options.candump.empty()) {
    throw std::runtime_error("interrupted; what was written is " + options.log_out + ".partial");
  }
  process.finish();
  log.close();
  say_goodbye(process, source);
  return kExitDone;
}

int run(const Options& options) {
  if (options.configuration_files.empty()) {
    throw ConfigurationError("the rig's configuration is needed: --config FILE");
  }
  const RigConfiguration rig =
      load_rig_configuration(options.configuration_files, options.settings);
  HallArrayLayout layout = load_hall_array_layout(rig, options.configuration_files);
  const bool into_log = !options.log_out.empty();
  std::unique_ptr<FrameSource> source;
  if (options.candump.empty()) {
    source = std::make_unique<SocketSource>(rig.can_hall_array);
  } else {
    source = std::make_unique<CandumpSource>(options.candump, !into_log);
  }
  if (into_log) return run_into_log(rig, std::move(layout), *source, options);
  const std::string url = resolve_lcm_url(options.lcm_url);
  for (const std::string& problem : check_host(url)) spdlog::warn("{}", problem);
  LcmBus bus(url);
  CanHallArrayProcess process(bus, rig, std::move(layout));
  spdlog::info("running on {}", url);
  return run_live(process, *source, bus);
}

}  // namespace

int run_can_hall_array(int argc, char** argv) {
  CLI::App app(
      "Turns the Hall array's CAN frames into readings and coil currents, as the CAN database "
      "says.\n\n"
      "Live:             can_hall_array --config config/rigs/lab.yaml\n"
      "From a recording: can_hall_array --config config/rigs/lab.yaml --candump FILE "
      "--log-out raw.lcmlog",
      "can_hall_array");
  Options options;
  add_configuration_options(app, options.configuration_files, options.settings);
  app.add_option("--candump", options.candump,
                 "read this log of `candump -l` (frames of all its interfaces) instead of the CAN "
                 "interface; live: as fast as it was recorded")
      ->check(CLI::ExistingFile);
  app.add_option("--log-out", options.log_out, "write this LCM log instead of going live");
  app.add_option("--lcm-url", options.lcm_url,
                 std::string("LCM URL; default: $LCM_DEFAULT_URL, else ") + kDefaultLcmUrl);
  return run_command_line(app, argc, argv, [&] { return run(options); });
}

}  // namespace gastronaut

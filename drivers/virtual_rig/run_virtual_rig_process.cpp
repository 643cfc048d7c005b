#include "virtual_rig/run_virtual_rig_process.hpp"

#include <spdlog/spdlog.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <chrono>
#include <condition_variable>
#include <deque>
#include <exception>
#include <filesystem>
#include <gastronaut/coil_currents_t.hpp>
#include <gastronaut/hall_array_t.hpp>
#include <gastronaut/process_status_t.hpp>
#include <lcm/lcm-cpp.hpp>
#include <mutex>
#include <optional>
#include <thread>

#include "bus/host_check.hpp"
#include "bus/lcm_bus.hpp"
#include "bus/log_file.hpp"
#include "bus/wall_clock.hpp"
#include "can/can_socket.hpp"
#include "can/hall_array_layout.hpp"
#include "numerics/parallel.hpp"
#include "process/channels.hpp"
#include "process/command_line.hpp"
#include "process/progress.hpp"
#include "process/usage.hpp"
#include "virtual_rig/virtual_rig_process.hpp"

namespace gastronaut {
namespace {

using Clock = std::chrono::steady_clock;

constexpr double kAhead = 1;         // seconds that live messages are made ahead of their time
constexpr double kStartDelay = 0.5;  // seconds from start to the first live message
constexpr double kTooLate = 0.05;    // seconds: a picture that cannot be in time is skipped
constexpr double kStatusPeriod = 1;  // seconds

struct Options {
  std::string scenario;
  std::vector<std::string> settings;
  std::string lcm_url;
  std::string log_out;
  std::string surface_out;
  std::string truth_out;
  std::string can;
  double duration = 0;
  double rate_factor = 1;
  int threads = 0;
};

void write_side_files(const VirtualRigProcess& rig, const Options& options) {
  if (!options.surface_out.empty()) rig.write_surface(options.surface_out);
  if (!options.truth_out.empty()) rig.write_truth(options.truth_out);
}

double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

int run_into_log(const VirtualRigScenario& scenario, const Options& options) {
  LogWriter log(options.log_out);
  VirtualRigProcess rig(scenario, static_cast<std::int64_t>(scenario.start_utime),
                        [&log](const std::string& channel, const std::vector<std::uint8_t>& payload,
                               std::int64_t utime) { log.write(channel, payload, utime); });
  write_side_files(rig, options);
  const double duration = options.duration > 0 ? options.duration : scenario.duration;
  const Clock::time_point start = Clock::now();
  {
    Progress progress("virtual_rig");
    while (rig.next_time() < duration) {
      if (stop_requested()) {
        throw std::runtime_error("interrupted; what was written is " + options.log_out +
                                 ".partial");
      }
      progress.update(rig.next_time() / duration);
      rig.step();
    }
  }
  log.close();
  const double elapsed = seconds_since(start);
  spdlog::info("{}: {:g} s of '{}' in {:.1f} s; {} pictures, {:.1f} a second", options.log_out,
               duration, scenario.rig.name, elapsed, rig.pictures(),
               static_cast<double>(rig.pictures()) / elapsed);
  return kExitDone;
}

// Readings and currents as frames on a CAN interface, as a Hall array would send them. An interface
// that goes away is waited for; what was to be sent meanwhile is lost.
class CanOutput {
 public:
  CanOutput(const VirtualRigScenario& scenario, const Options& options)
      : interface_(options.can), layout_(load_hall_array_layout(scenario.rig, {options.scenario})) {
    socket_.emplace(interface_, std::vector<std::pair<std::uint32_t, bool>>{});
  }

  // False: that is no message for a CAN bus.
  bool take(const std::string& channel, const std::vector<std::uint8_t>& payload) {
    if (channel == channel::kHallArray) {
      hall_array_t reading;
      decode_message(payload, reading);
      std::vector<double> values;
      for (const std::vector<float>& sensor : reading.field) {
        values.insert(values.end(), sensor.begin(), sensor.end());
      }
      if (layout_.has_status()) {
        values.insert(values.end(), reading.status.begin(), reading.status.end());
      }
      send(CanStream::kField, reading.seq, values);
      return true;
    }
    if (channel != channel::kCoilCurrents) return false;
    coil_currents_t currents;
    decode_message(payload, currents);
    const std::vector<double> values(currents.current.begin(), currents.current.end());
    send(CanStream::kCurrents, currents.seq, values);
    return true;
  }
  std::int64_t sent() const { return sent_; }
  std::int64_t lost() const { return lost_; }

 private:
  void send(CanStream stream, std::int32_t seq, const std::vector<double>& values) {
    for (const CanFrame& frame : layout_.encode(stream, static_cast<std::uint32_t>(seq), values)) {
      ++(try_to_send(frame) ? sent_ : lost_);
    }
  }
  bool try_to_send(const CanFrame& frame) {
    try {
      if (!socket_) {
        socket_.emplace(interface_, std::vector<std::pair<std::uint32_t, bool>>{});
        spdlog::info("sending on {}", interface_);
      }
      return socket_->send(frame);
    } catch (const CanUnavailable& unavailable) {
      if (socket_) spdlog::warn("{}", unavailable.what());
      socket_.reset();
      return false;
    }
  }

  std::string interface_;
  HallArrayLayout layout_;
  std::optional<CanSocket> socket_;
  std::int64_t sent_ = 0;
  std::int64_t lost_ = 0;
};

// Messages wait here, made ahead of their time by one thread, until another sends them.
class LiveRun {
 public:
  LiveRun(const VirtualRigScenario& scenario, const Options& options, lcm::LCM& lcm)
      : options_(options),
        lcm_(lcm),
        start_utime_(wall_utime() + static_cast<std::int64_t>(kStartDelay * 1e6)),
        rig_(scenario, start_utime_,
             [this](const std::string& channel, std::vector<std::uint8_t> payload,
                    std::int64_t utime) {
               push({channel, std::move(payload), utime});
             }) {
    start_ = Clock::now() + std::chrono::microseconds(start_utime_ - wall_utime());
    rig_.skip_pictures([this](double time) { return lateness(time) > kTooLate; });
    status_.name = "virtual_rig";
    std::array<char, 256> host{};
    gethostname(host.data(), host.size() - 1);
    status_.host = host.data();
    status_.pid = getpid();
    if (!options.can.empty()) can_.emplace(scenario, options);
  }

  const VirtualRigProcess& rig() const { return rig_; }

  void run() {
    std::thread maker([this] { make(); });
    std::exception_ptr failure;
    try {
      send();
    } catch (...) {
      failure = std::current_exception();
    }
    {
      const std::lock_guard lock(mutex_);
      stopped_ = true;
    }
    changed_.notify_all();
    maker.join();
    for (const std::exception_ptr& thrown : {failure, failure_}) {
      if (thrown) std::rethrow_exception(thrown);
    }
    spdlog::info("stopped: {} messages, {} pictures, {} pictures skipped to keep up",
                 status_.published, rig_.pictures(), rig_.pictures_skipped());
    if (can_) spdlog::info("{} CAN frames sent, {} lost", can_->sent(), can_->lost());
  }

 private:
  struct Message {
    std::string channel;
    std::vector<std::uint8_t> payload;
    std::int64_t utime;
  };

  // Wall time since the scenario's start, scaled; how far `time` of the scenario lies behind it.
  double now() const { return seconds_since(start_) * options_.rate_factor; }
  double lateness(double time) const { return (now() - time) / options_.rate_factor; }
  double time_of(std::int64_t utime) const {
    return static_cast<double>(utime - start_utime_) * 1e-6;
  }

  void push(Message message) {
    {
      const std::lock_guard lock(mutex_);
      queue_.push_back(std::move(message));
    }
    changed_.notify_all();
  }

  void make() {
    try {
      while (options_.duration == 0 || rig_.next_time() < options_.duration) {
        {
          std::unique_lock lock(mutex_);
          while (!stopped_ && -lateness(rig_.next_time()) > kAhead) {
            changed_.wait_for(lock, std::chrono::duration<double>(kAhead / 4));
          }
          if (stopped_) return;
        }
        rig_.step();
      }
    } catch (...) {
      failure_ = std::current_exception();
    }
    const std::lock_guard lock(mutex_);
    all_made_ = true;
  }

  void send() {
    Clock::time_point status_due = Clock::now();
    while (!stop_requested()) {
      if (Clock::now() >= status_due) {
        report();
        status_due += std::chrono::duration_cast<Clock::duration>(
            std::chrono::duration<double>(kStatusPeriod));
      }
      std::unique_lock lock(mutex_);
      if (queue_.empty() && all_made_) return;
      const double wait = queue_.empty() ? 0.1 : -lateness(time_of(queue_.front().utime));
      if (wait > 0) {
        constexpr double kMostWait = 0.1;  // so that signals and status are not forgotten
        changed_.wait_for(lock, std::chrono::duration<double>(std::min(wait, kMostWait)));
        continue;
      }
      const Message message = std::move(queue_.front());
      queue_.pop_front();
      lock.unlock();
      if (!can_ || !can_->take(message.channel, message.payload)) {
        lcm_.publish(message.channel, message.payload.data(),
                     static_cast<unsigned>(message.payload.size()));
      }
      ++status_.published;
      delays_.push_back(lateness(time_of(message.utime)));
    }
  }

  void report() {
    std::sort(delays_.begin(), delays_.end());
    const auto percentile = [this](std::size_t percent) {
      return delays_.empty() ? 0.0 : delays_[(delays_.size() - 1) * percent / 100];
    };
    const std::int64_t skipped = rig_.pictures_skipped();
    const bool slow = skipped > status_.dropped;
    if (slow && status_.dropped == 0) spdlog::warn("{}", kTooSlow);
    status_.utime = wall_utime();
    status_.state = slow ? process_status_t::STATE_DEGRADED : process_status_t::STATE_RUNNING;
    status_.message = slow ? kTooSlow : "";
    status_.dropped = skipped;
    status_.latency_p50 = percentile(50);
    status_.latency_p99 = percentile(99);
    const double cpu = cpu_seconds();
    status_.cpu = (cpu - last_cpu_) / kStatusPeriod;
    last_cpu_ = cpu;
    status_.resident_bytes = resident_bytes();
    lcm_.publish(channel::kProcessStatus, &status_);
    delays_.clear();
  }

  static constexpr const char* kTooSlow =
      "this machine does not render in real time: pictures are skipped; take a smaller camera "
      "(--set camera_file=../cameras/capsule_250x250.yaml) or --rate-factor below 1";

  const Options& options_;
  lcm::LCM& lcm_;
  std::int64_t start_utime_;
  VirtualRigProcess rig_;
  std::optional<CanOutput> can_;
  Clock::time_point start_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Message> queue_;
  bool all_made_ = false;
  bool stopped_ = false;
  std::exception_ptr failure_;
  std::vector<double> delays_;  // seconds, since the last status
  double last_cpu_ = 0;
  process_status_t status_{};
};

int run_live(const VirtualRigScenario& scenario, const Options& options) {
  const std::string url = resolve_lcm_url(options.lcm_url);
  for (const std::string& problem : check_host(url)) spdlog::warn("{}", problem);
  lcm::LCM lcm(url);
  if (!lcm.good()) throw std::runtime_error("LCM cannot be started on " + url);
  LiveRun run(scenario, options, lcm);
  write_side_files(run.rig(), options);
  spdlog::info("playing '{}' on {}", scenario.rig.name, url);
  run.run();
  return kExitDone;
}

}  // namespace

int run_virtual_rig(int argc, char** argv) {
  CLI::App app(
      "Stands in for camera, Hall array and coils: plays a scenario, with ground truth.\n\n"
      "Live:       virtual_rig --scenario config/scenarios/st0.yaml\n"
      "Into a log: virtual_rig --scenario config/scenarios/st0.yaml --log-out raw.lcmlog",
      "virtual_rig");
  Options options;
  app.add_option("--scenario", options.scenario, "what to play")
      ->required()
      ->check(CLI::ExistingFile);
  app.add_option("--set", options.settings,
                 "override one value, e.g. --set trajectory.path_length=10cm")
      ->allow_extra_args(false);
  auto* log_out = app.add_option("--log-out", options.log_out,
                                 "write this log as fast as can be instead of going live");
  app.add_option("--surface-out", options.surface_out, "write the true surface: PLY, wall at rest");
  app.add_option("--truth-out", options.truth_out,
                 "write the rig with its true sensor errors, coil matrix and moment: YAML");
  app.add_option("--can", options.can,
                 "live: put the Hall array's readings and the currents on this CAN interface, as "
                 "can_hall_array.dbc says, instead of LCM")
      ->excludes(log_out);
  app.add_option("--duration", options.duration,
                 "seconds; default: the scenario's for a log, without end live")
      ->check(CLI::PositiveNumber);
  app.add_option("--rate-factor", options.rate_factor, "live: so many times faster than real time")
      ->check(CLI::PositiveNumber);
  app.add_option("--lcm-url", options.lcm_url,
                 std::string("LCM URL; default: $LCM_DEFAULT_URL, else ") + kDefaultLcmUrl);
  app.add_option("--threads", options.threads, "threads to use; default: one a core")
      ->check(CLI::NonNegativeNumber);
  return run_command_line(app, argc, argv, [&] {
    set_thread_count(options.threads);
    const VirtualRigScenario scenario = load_scenario(options.scenario, options.settings);
    return options.log_out.empty() ? run_live(scenario, options) : run_into_log(scenario, options);
  });
}

}  // namespace gastronaut

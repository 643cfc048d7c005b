#include "process/status_reporter.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cctype>

#include "bus/wall_clock.hpp"
#include "process/channels.hpp"
#include "process/service_manager.hpp"
#include "process/usage.hpp"

namespace gastronaut {

StatusReporter::StatusReporter(LcmBus& bus, const std::string& name) : bus_(bus) {
  status_.name = name;
  std::array<char, 256> host{};
  gethostname(host.data(), host.size() - 1);
  status_.host = host.data();
  status_.pid = getpid();
  notify_service_manager("READY=1");
}

bool StatusReporter::due() const {
  return std::chrono::steady_clock::now() - last_ >= std::chrono::seconds(1);
}

void StatusReporter::tick(const BusCounters& counters, ProcessState state,
                          const std::string& message) {
  if (!due()) return;
  const auto now = std::chrono::steady_clock::now();
  const double elapsed = std::chrono::duration<double>(now - last_).count();
  last_ = now;
  const double cpu = cpu_seconds();
  const LcmBus::Latency latency = bus_.latency();
  status_.utime = wall_utime();
  status_.state = static_cast<std::int8_t>(state);
  status_.message = message;
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
  // What others wrote into a message must not pass for an assignment of its own.
  std::string line = message.empty() ? "running" : message;
  std::replace_if(
      line.begin(), line.end(), [](unsigned char c) { return std::iscntrl(c); }, ' ');
  notify_service_manager("READY=1\nWATCHDOG=1\nSTATUS=" + line);
}

}  // namespace gastronaut

#include "bus/lcm_bus.hpp"

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <stdexcept>

#include "bus/host_check.hpp"
#include "bus/wall_clock.hpp"

namespace gastronaut {
namespace {

constexpr std::chrono::milliseconds kPoll{100};
constexpr std::int64_t kLatencyWindow = 10'000'000;  // microseconds
// liblcm drops in silence what does not fit its own queue. Ours has no limit and its drops are
// counted, so the library's only bridges the moment until the receiver thread runs.
constexpr int kLibraryQueue = 2000;

}  // namespace

std::string resolve_lcm_url(const std::string& option) {
  if (!option.empty()) return option;
  const char* environment = std::getenv("LCM_DEFAULT_URL");
  return environment != nullptr && *environment != '\0' ? environment : kDefaultLcmUrl;
}

LcmBus::LcmBus(const std::string& url) : lcm_(url), url_(url) {
  if (!lcm_.good()) {
    std::string message = "LCM cannot be started on " + url;
    for (const std::string& problem : check_host(url)) message += "\n  " + problem;
    throw std::runtime_error(message);
  }
}

LcmBus::~LcmBus() {
  receiving_ = false;
  if (receiver_.joinable()) receiver_.join();
}

void LcmBus::listen(const std::string& channel) {
  // Through the C interface: the C++ one's subscriptions fail UndefinedBehaviorSanitizer.
  lcm_subscription_t* subscription =
      lcm_subscribe(lcm_.getUnderlyingLCM(), channel.c_str(), &LcmBus::on_message, this);
  if (subscription == nullptr) throw std::runtime_error("LCM cannot subscribe to " + channel);
  lcm_subscription_set_queue_capacity(subscription, kLibraryQueue);
}

void LcmBus::on_message(const lcm_recv_buf_t* buffer, const char* channel, void* context) {
  auto& bus = *static_cast<LcmBus*>(context);
  const auto* bytes = static_cast<const std::uint8_t*>(buffer->data);
  // An exception must not pass through the C library; out of memory here loses one message.
  try {
    std::vector<std::uint8_t> payload(bytes, bytes + buffer->data_size);
    const std::lock_guard lock(bus.mutex_);
    bus.inbox_.emplace_back(channel, std::move(payload));
  } catch (const std::bad_alloc&) {
    return;
  }
  bus.arrived_.notify_one();
}

void LcmBus::receive_loop() {
  while (receiving_) lcm_.handleTimeout(static_cast<int>(kPoll.count()));
}

bool LcmBus::take_inbox() {
  std::deque<std::pair<std::string, std::vector<std::uint8_t>>> taken;
  {
    const std::lock_guard lock(mutex_);
    taken.swap(inbox_);
  }
  for (const auto& [channel, payload] : taken) receive(channel, payload);
  return !taken.empty();
}

void LcmBus::run(const std::atomic<bool>& stop, const std::function<void()>& tick) {
  receiving_ = true;
  receiver_ = std::thread([this] { receive_loop(); });
  auto next_tick = std::chrono::steady_clock::now();
  while (!stop) {
    {
      std::unique_lock lock(mutex_);
      arrived_.wait_for(lock, kPoll, [this] { return !inbox_.empty(); });
    }
    // After each event the inbox is looked at again, so that skipping sees what came meanwhile.
    do {
      take_inbox();
      skip_to_newest();
      if (std::chrono::steady_clock::now() >= next_tick) {
        tick();
        next_tick = std::chrono::steady_clock::now() + kPoll;
      }
    } while (handle_next() && !stop);
  }
  receiving_ = false;
  receiver_.join();
}

void LcmBus::drain() {
  // What the library still holds; a source that goes on sending must not keep us here.
  const auto deadline = std::chrono::steady_clock::now() + kPoll;
  while (lcm_.handleTimeout(0) > 0 && std::chrono::steady_clock::now() < deadline) {
  }
  take_inbox();
  while (handle_remaining()) {
  }
}

void LcmBus::send(const std::string& channel, std::vector<std::uint8_t> payload,
                  std::int64_t utime) {
  if (lcm_.publish(channel, payload.data(), static_cast<unsigned>(payload.size())) != 0) {
    set_health(ProcessState::kDegraded, "LCM could not publish on " + channel);
  }
  const std::int64_t now = wall_utime();
  latencies_.emplace_back(now, static_cast<double>(now - utime) * 1e-6);
  while (!latencies_.empty() && latencies_.front().first < now - kLatencyWindow) {
    latencies_.pop_front();
  }
}

LcmBus::Latency LcmBus::latency() const {
  std::vector<double> seconds;
  seconds.reserve(latencies_.size());
  for (const auto& sample : latencies_) seconds.push_back(sample.second);
  if (seconds.empty()) return {};
  std::sort(seconds.begin(), seconds.end());
  const auto quantile = [&seconds](double q) {
    return seconds[static_cast<std::size_t>(q * static_cast<double>(seconds.size() - 1))];
  };
  return {quantile(0.5), quantile(0.99)};
}

}  // namespace gastronaut

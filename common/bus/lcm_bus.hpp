// The bus over stock LCM.
#pragma once

#include <atomic>
#include <condition_variable>
#include <deque>
#include <functional>
#include <lcm/lcm-cpp.hpp>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "bus/bus.hpp"

namespace gastronaut {

// ttl=0 keeps packets on this host; the receive buffer holds a second of pictures. Without
// recv_buf_size large messages are lost (architecture.md, "LCM as it is").
inline constexpr const char* kDefaultLcmUrl =
    "udpm://239.255.76.67:7667?ttl=0&recv_buf_size=33554432";

// The option if given, else LCM_DEFAULT_URL from the environment, else kDefaultLcmUrl.
std::string resolve_lcm_url(const std::string& option);

class LcmBus : public Bus {
 public:
  // Throws std::runtime_error with what is missing on this host when LCM cannot be started.
  explicit LcmBus(const std::string& url);
  ~LcmBus() override;
  LcmBus(const LcmBus&) = delete;
  LcmBus& operator=(const LcmBus&) = delete;

  // Handles events on the calling thread until `stop` is set; a second thread only takes messages
  // off the network. `tick` is called about ten times a second between events.
  void run(const std::atomic<bool>& stop, const std::function<void()>& tick);
  // Hands out everything received so far, waiting for nothing.
  void drain();

  // Seconds from utime to publishing, of what was published in the last ten seconds.
  struct Latency {
    double p50 = 0;
    double p99 = 0;
  };
  Latency latency() const;

  // Past counters and event order: for PROCESS_STATUS.
  template <class Message>
  void publish_status(const std::string& channel, const Message& message) {
    lcm_.publish(channel, &message);
  }

 private:
  void send(const std::string& channel, std::vector<std::uint8_t> payload,
            std::int64_t utime) override;
  void listen(const std::string& channel) override;
  static void on_message(const lcm_recv_buf_t* buffer, const char* channel, void* bus);
  void receive_loop();
  bool take_inbox();

  lcm::LCM lcm_;
  std::string url_;
  std::thread receiver_;
  std::atomic<bool> receiving_{false};
  std::mutex mutex_;
  std::condition_variable arrived_;
  std::deque<std::pair<std::string, std::vector<std::uint8_t>>> inbox_;
  std::deque<std::pair<std::int64_t, double>> latencies_;  // (wall microseconds, seconds)
};

}  // namespace gastronaut

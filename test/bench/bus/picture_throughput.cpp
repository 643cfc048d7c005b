// picture_throughput BYTES RATE SECONDS [LCM_URL]: one process publishes pictures, another receives
// them through LcmBus; prints how many arrived and how late. Run it in a network namespace of its
// own (test/system/in_network_namespace); scripts/bench does, for the sizes and sysctls that
// matter.
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>

#include "bus/lcm_bus.hpp"
#include "bus/wall_clock.hpp"

namespace {

using Clock = std::chrono::steady_clock;
constexpr std::chrono::milliseconds kSubscriberStarts{500};
constexpr std::chrono::milliseconds kLastArrives{1000};

void publish_pictures(const std::string& url, int bytes, double rate, int count) {
  lcm::LCM lcm(url);
  gastronaut::image_t picture{};
  picture.size = bytes;
  picture.data.assign(static_cast<std::size_t>(bytes), 0x5a);
  const auto start = Clock::now();
  for (int i = 0; i < count; ++i) {
    std::this_thread::sleep_until(start + std::chrono::duration_cast<Clock::duration>(
                                              std::chrono::duration<double>(i / rate)));
    picture.utime = gastronaut::wall_utime();
    lcm.publish("CAMERA", &picture);
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) {
    std::fprintf(stderr, "usage: picture_throughput BYTES RATE SECONDS [LCM_URL]\n");
    return 2;
  }
  const int bytes = std::atoi(argv[1]);
  const double rate = std::atof(argv[2]);
  const int count = static_cast<int>(rate * std::atof(argv[3]));
  const std::string url = argc > 4 ? argv[4] : gastronaut::kDefaultLcmUrl;
  const pid_t publisher = fork();
  if (publisher == 0) {
    std::this_thread::sleep_for(kSubscriberStarts);
    publish_pictures(url, bytes, rate, count);
    _exit(0);
  }
  gastronaut::LcmBus bus(url);
  int received = 0;
  double slowest = 0;
  constexpr double kAnyLag = 10;
  bus.subscribe<gastronaut::image_t>("CAMERA", kAnyLag, [&](const gastronaut::image_t& picture) {
    ++received;
    slowest =
        std::max(slowest, static_cast<double>(gastronaut::wall_utime() - picture.utime) * 1e-3);
  });
  std::atomic<bool> stop{false};
  std::thread waiter([&] {
    waitpid(publisher, nullptr, 0);
    std::this_thread::sleep_for(kLastArrives);
    stop = true;
  });
  bus.run(stop, [] {});
  waiter.join();
  std::printf("%7d bytes at %2.0f Hz: %4d of %4d received, %4.1f %% lost, slowest %.1f ms\n", bytes,
              rate, received, count, 100.0 * (count - received) / count, slowest);
  return 0;
}

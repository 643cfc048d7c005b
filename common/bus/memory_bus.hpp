// Processes joined inside one program: replay, processes on a log, tests. What one publishes, the
// others receive at once, and handle when EventOrder says that it is their turn.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "bus/bus.hpp"

namespace gastronaut {

class MemoryNetwork {
 public:
  // Everything that any process publishes, in order.
  using Sink = std::function<void(const std::string& channel, Bytes payload, std::int64_t utime)>;

  explicit MemoryNetwork(Sink sink = {});
  ~MemoryNetwork();

  // A bus for one more process; lives as long as the network. Upstream processes first: that is
  // the order in which they are served.
  Bus& connect();

  // A message from outside (a log, a test) to all who subscribed.
  void inject(const std::string& channel, Bytes payload);
  // Handles events until every process waits for more input.
  void run_until_idle();
  // The input has ended: handles what is left, waiting for nothing. `finish(i)` is called for the
  // process on bus i as soon as everything before it has come to rest.
  void finish(const std::function<void(std::size_t)>& finish);

  // Called around every handled event of process i, for timing.
  std::function<void(std::size_t process)> before_event;
  std::function<void(std::size_t process)> after_event;

 private:
  class MemoryBus;
  void deliver(const std::string& channel, Bytes payload);
  bool handle(std::size_t process, bool remaining);

  Sink sink_;
  std::vector<std::unique_ptr<MemoryBus>> buses_;
};

}  // namespace gastronaut

#include "bus/memory_bus.hpp"

namespace gastronaut {

class MemoryNetwork::MemoryBus : public Bus {
 public:
  explicit MemoryBus(MemoryNetwork& network) : network_(network) {}

 private:
  void send(const std::string& channel, std::vector<std::uint8_t> payload,
            std::int64_t utime) override {
    if (network_.sink_) network_.sink_(channel, payload, utime);
    network_.deliver(channel, payload);
  }

  MemoryNetwork& network_;
};

MemoryNetwork::MemoryNetwork(Sink sink) : sink_(std::move(sink)) {}
MemoryNetwork::~MemoryNetwork() = default;

Bus& MemoryNetwork::connect() {
  buses_.push_back(std::make_unique<MemoryBus>(*this));
  return *buses_.back();
}

void MemoryNetwork::deliver(const std::string& channel, Bytes payload) {
  for (const auto& bus : buses_) bus->receive(channel, payload);
}

void MemoryNetwork::inject(const std::string& channel, Bytes payload) { deliver(channel, payload); }

bool MemoryNetwork::handle(std::size_t process, bool remaining) {
  if (before_event && buses_[process]->pending() > 0) before_event(process);
  const bool handled =
      remaining ? buses_[process]->handle_remaining() : buses_[process]->handle_next();
  if (handled && after_event) after_event(process);
  return handled;
}

void MemoryNetwork::run_until_idle() {
  for (bool progress = true; progress;) {
    progress = false;
    for (std::size_t i = 0; i < buses_.size(); ++i) {
      while (handle(i, false)) progress = true;
    }
  }
}

void MemoryNetwork::finish(const std::function<void(std::size_t)>& finish) {
  run_until_idle();
  for (std::size_t i = 0; i < buses_.size(); ++i) {
    while (handle(i, true)) run_until_idle();
    finish(i);
    run_until_idle();
  }
  // Processes in a loop: what the later ones published last still reaches the earlier ones.
  for (bool progress = true; progress;) {
    progress = false;
    for (std::size_t i = 0; i < buses_.size(); ++i) {
      while (handle(i, true)) progress = true;
    }
  }
}

}  // namespace gastronaut

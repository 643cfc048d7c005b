// What a process sees of the world: subscribe, publish, the current event's time.
//
// Behind it is stock LCM (lcm_bus.hpp), a log or another process in the same program
// (memory_bus.hpp). Whichever it is, handlers are called one at a time, in the order of utime that
// EventOrder promises, with messages that have been checked byte by byte; a process cannot tell
// the difference, and that is what makes replay exact.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "bus/event_order.hpp"
#include "bus/wire.hpp"

namespace gastronaut {

enum class ProcessState : std::int8_t { kStarting = 0, kRunning = 1, kDegraded = 2, kFailed = 3 };

struct BusCounters {
  std::int64_t received = 0;
  std::int64_t published = 0;
  std::int64_t dropped = 0;  // skipped to keep up
  std::int64_t late = 0;     // came after their turn
  std::int64_t lost = 0;     // gaps in seq numbers
  std::int64_t corrupt = 0;
  std::int64_t foreign = 0;  // another type on our channel
};

enum class Overload {
  kKeepAll,     // every message counts: field readings, poses
  kKeepNewest,  // live, a slow process skips to the newest: pictures
};

class Bus {
 public:
  virtual ~Bus() = default;

  // `handler` gets every good message of the channel in the order of utime. `lag` in seconds: how
  // far the channel may fall behind in event time before it is no longer waited for. Subscribe
  // before the first message is handled; the order of subscribing orders equal utimes.
  template <class Message>
  void subscribe(const std::string& channel, double lag,
                 std::function<void(const Message&)> handler,
                 Overload overload = Overload::kKeepAll) {
    subscribe_as(add_input(channel, lag, overload), channel, std::move(handler));
  }

  // A channel that answers what this process publishes: `handler` gets the messages that are
  // awaited, and no other. `lag` as above: a channel farther behind the newest event of the others
  // is not waited for.
  template <class Message>
  void subscribe_feedback(const std::string& channel, double lag,
                          std::function<void(const Message&)> handler) {
    subscribe_as(add_feedback(channel, lag), channel, std::move(handler));
  }
  // The answer of that utime is the next event, and nothing else is handled until it has come or
  // will not come (EventOrder). False when there is nothing to wait for: the answer will not come.
  bool await(const std::string& channel, std::int64_t utime);

  // The message's utime is that of the measurement that it is about.
  template <class Message>
  void publish(const std::string& channel, const Message& message) {
    send(channel, encode_message(message), message.utime);
    ++counters_.published;
  }

  // utime of the event being handled, microseconds.
  std::int64_t event_utime() const { return event_utime_; }

  // Whether another input has an event of the same utime, to be handled next.
  bool more_at_this_time() const { return order_.next_utime() == event_utime_; }

  // What PROCESS_STATUS says of this process until it says otherwise; `message` tells what is wrong
  // and what to do about it.
  void set_health(ProcessState state, std::string message);

  // For whoever runs the process: bytes in, events handled.
  void receive(const std::string& channel, Bytes payload);
  // Handles the next event whose turn has come; false when there is none.
  bool handle_next();
  // The same, waiting for nothing: at the end.
  bool handle_remaining();

  const BusCounters& counters() const { return counters_; }
  ProcessState state() const { return state_; }
  // Health in words: what the process said, what is waited for, what is silent or damaged.
  std::string describe_health() const;
  std::size_t pending() const { return order_.pending(); }

 protected:
  virtual void send(const std::string& channel, std::vector<std::uint8_t> payload,
                    std::int64_t utime) = 0;
  // The channel is wanted from now on.
  virtual void listen(const std::string& channel) { (void)channel; }

  BusCounters counters_;
  EventOrder order_;
  // Live transports call this before handling: inputs that skip drop all but their newest.
  void skip_to_newest();

 private:
  template <class Message>
  void subscribe_as(std::size_t number, const std::string& channel,
                    std::function<void(const Message&)> handler) {
    decoders_[channel] = [this, number, handler = std::move(handler)](Bytes payload) {
      auto message = std::make_shared<Message>();
      if (!accept(decode_message(payload, *message), number)) return;
      if constexpr (requires { message->seq; }) count_gap(number, message->seq);
      if constexpr (requires { message->metadata; }) {
        if (const auto seq = told_seq(*message)) count_gap(number, *seq);
      }
      push(number, message->utime, [message, handler] { handler(*message); });
    };
    listen(channel);
  }

  // Pictures carry their number as text in their metadata.
  template <class Picture>
  static std::optional<std::int64_t> told_seq(const Picture& picture) {
    for (const auto& entry : picture.metadata) {
      if (entry.key == "seq") return parse_seq({entry.value.begin(), entry.value.end()});
    }
    return std::nullopt;
  }
  static std::optional<std::int64_t> parse_seq(const std::string& text);

  struct Input {
    std::string channel;
    Overload overload = Overload::kKeepAll;
    bool seen = false;
    std::int64_t next_seq = 0;
    std::int64_t bad = 0;
  };
  std::size_t add_input(const std::string& channel, double lag, Overload overload);
  std::size_t add_feedback(const std::string& channel, double lag);
  bool accept(DecodeResult result, std::size_t number);
  void count_gap(std::size_t number, std::int64_t seq);
  void push(std::size_t number, std::int64_t utime, EventOrder::Action action);
  bool handle(std::optional<EventOrder::Event> event);

  std::map<std::string, std::function<void(Bytes)>> decoders_;
  std::vector<Input> inputs_;
  std::int64_t event_utime_ = 0;
  ProcessState state_ = ProcessState::kRunning;
  std::string message_;
};

}  // namespace gastronaut

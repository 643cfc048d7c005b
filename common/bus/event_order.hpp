// Orders the messages of several channels by utime, not by arrival.
//
// An event is handed out once every live input has passed it: has delivered something at least as
// new. Equal utimes come in the order in which the inputs were added. An input that lags more than
// its limit behind the newest event is silent: it is not waited for until it is back. What comes
// after its turn is late: dropped and counted. Everything is a function of the sequence of pushes.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <vector>

namespace gastronaut {

class EventOrder {
 public:
  using Action = std::function<void()>;
  struct Event {
    std::int64_t utime = 0;
    Action handle;
  };
  enum class PushResult {
    kQueued,
    kLate,         // its turn has passed, or the same input already delivered this utime
    kImplausible,  // further in the future than any pause; believed when the next one confirms it
  };

  // `lag` in microseconds of event time. Returns the input's number.
  int add_input(std::string name, std::int64_t lag);
  PushResult push(int input, std::int64_t utime, Action handle);
  // The next event whose turn has come.
  std::optional<Event> pop();
  // The next event whether or not inputs are waited for: for the end of a log, or of a process.
  std::optional<Event> drain();

  // Of the input's events whose turn has come, drops all but the newest; returns how many. For
  // inputs where a slow reader wants the present, not the past.
  std::size_t keep_newest(int input);

  // Name of the live input that the oldest event waits for; empty when nothing waits.
  std::string blocker() const;
  std::vector<std::string> silent_inputs() const;
  std::size_t pending() const;

 private:
  struct Input {
    std::string name;
    std::int64_t lag = 0;
    std::optional<std::int64_t> newest;
    std::optional<std::int64_t> handed_out;
    std::optional<std::int64_t> suspect;  // utime of an implausible message, awaiting confirmation
    std::deque<Event> queue;              // ascending utime
  };

  bool silent(const Input& input) const;
  std::optional<std::size_t> oldest() const;
  const Input* blocking(std::size_t candidate) const;
  Event take(std::size_t input);

  std::vector<Input> inputs_;
  std::optional<std::int64_t> first_;  // utime of the first event ever: silence counts from here
  std::optional<std::int64_t> newest_;
  std::int64_t last_utime_ = 0;  // of the event handed out last
  std::size_t last_input_ = 0;
  bool any_handed_out_ = false;
};

}  // namespace gastronaut

// Orders the messages of several channels by utime, not by arrival.
//
// An event is handed out once every live input has passed it: has delivered something at least as
// new. Equal utimes come in the order in which the inputs were added. An input that lags more than
// its limit behind the newest event is silent: it is not waited for until it is back. What comes
// after its turn is late: dropped and counted, but its input is heard. Everything is a function of
// the sequence of pushes.
//
// A feedback input answers what its reader sends out. It is waited for only while the answer of one
// utime is awaited: no other event is handed out until that answer has come, which is then the next
// event, or what the feedback sent last is newer than it, or the other inputs are more than its
// limit beyond it: then it is silent, and not waited for until it sends again. What nobody awaits
// is dropped. Only its last message counts, so that a corrupt utime is forgotten with the next.
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
  int add_feedback(std::string name, std::int64_t lag);
  // From now on that feedback's answer of `utime` is awaited, and no other. False when there is
  // nothing to wait for.
  bool await(int feedback, std::int64_t utime);
  PushResult push(int input, std::int64_t utime, Action handle);
  // The next event whose turn has come.
  std::optional<Event> pop();
  // The next event whether or not inputs are waited for: for the end of a log, or of a process.
  std::optional<Event> drain();

  // Of the input's events whose turn has come, drops all but the newest; returns how many. For
  // inputs where a slow reader wants the present, not the past.
  std::size_t keep_newest(int input);

  // utime of the oldest event that is still to be handed out.
  std::optional<std::int64_t> next_utime() const;
  // Name of the live input that the oldest event waits for; empty when nothing waits.
  std::string blocker() const;
  std::vector<std::string> silent_inputs() const;
  std::size_t pending() const;

 private:
  struct Input {
    std::string name;
    std::int64_t lag = 0;
    bool is_feedback = false;            // then its queue stays empty
    bool is_silent = false;              // a feedback, which does not answer
    std::optional<std::int64_t> newest;  // of a feedback: the last
    std::optional<std::int64_t> handed_out;
    std::optional<std::int64_t> suspect;  // utime of an implausible message, awaiting confirmation
    std::deque<Event> queue;              // ascending utime
  };

  PushResult push_feedback(Input& input, std::int64_t utime, Action handle);
  void release_if_in_vain();
  bool silent(const Input& input) const;
  std::optional<std::size_t> oldest() const;
  const Input* blocking(std::size_t candidate) const;
  Event take(std::size_t input);

  std::vector<Input> inputs_;
  std::optional<std::int64_t> first_;   // utime of the first event ever: silence counts from here
  std::optional<std::int64_t> newest_;  // of all but feedback
  std::optional<std::int64_t> awaited_;
  std::size_t awaited_input_ = 0;
  std::optional<Event> answer_;  // has come, is handed out next
  std::int64_t last_utime_ = 0;  // of the event handed out last
  std::size_t last_input_ = 0;
  bool any_handed_out_ = false;
};

}  // namespace gastronaut

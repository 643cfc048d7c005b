#include "bus/event_order.hpp"

#include <algorithm>
#include <tuple>
#include <utility>

namespace gastronaut {
namespace {
// One flipped bit in a utime must not make every other input look silent for ever. No pause
// between two readings of a running rig is as long as this.
constexpr std::uint64_t kLongestPause = 60'000'000;  // microseconds

// later - earlier, which must not be the later one; unsigned, because corrupt utimes may be further
// apart than an int64 holds.
std::uint64_t microseconds_between(std::int64_t earlier, std::int64_t later) {
  return static_cast<std::uint64_t>(later) - static_cast<std::uint64_t>(earlier);
}
}  // namespace

int EventOrder::add_input(std::string name, std::int64_t lag) {
  Input input;
  input.name = std::move(name);
  input.lag = lag;
  inputs_.push_back(std::move(input));
  return static_cast<int>(inputs_.size()) - 1;
}

int EventOrder::add_feedback(std::string name, std::int64_t lag) {
  const int number = add_input(std::move(name), lag);
  inputs_.back().is_feedback = true;
  return number;
}

bool EventOrder::await(int feedback, std::int64_t utime) {
  answer_.reset();
  awaited_ = utime;
  awaited_input_ = static_cast<std::size_t>(feedback);
  release_if_in_vain();
  return awaited_.has_value();
}

void EventOrder::release_if_in_vain() {
  if (!awaited_) return;
  Input& input = inputs_[awaited_input_];
  if (newest_ && *newest_ > *awaited_ &&
      microseconds_between(*awaited_, *newest_) > static_cast<std::uint64_t>(input.lag)) {
    input.is_silent = true;
  }
  if (input.is_silent || (input.newest && *input.newest > *awaited_)) awaited_.reset();
}

EventOrder::PushResult EventOrder::push_feedback(Input& input, std::int64_t utime, Action handle) {
  if (newest_ && utime > *newest_ && microseconds_between(*newest_, utime) > kLongestPause) {
    return PushResult::kImplausible;
  }
  input.newest = utime;
  input.is_silent = false;
  if (awaited_ && *awaited_ == utime && &input == &inputs_[awaited_input_]) {
    awaited_.reset();
    answer_ = Event{utime, std::move(handle)};
  }
  release_if_in_vain();
  return PushResult::kQueued;
}

EventOrder::PushResult EventOrder::push(int number, std::int64_t utime, Action handle) {
  Input& input = inputs_[static_cast<std::size_t>(number)];
  if (input.is_feedback) return push_feedback(input, utime, std::move(handle));
  if (newest_ && utime > *newest_ && microseconds_between(*newest_, utime) > kLongestPause) {
    const bool confirmed = input.suspect && utime >= *input.suspect &&
                           microseconds_between(*input.suspect, utime) <= kLongestPause;
    if (!confirmed) {
      input.suspect = utime;
      return PushResult::kImplausible;
    }
  }
  input.suspect.reset();
  const bool turn_has_passed =
      any_handed_out_ && std::make_tuple(utime, static_cast<std::size_t>(number)) <=
                             std::make_tuple(last_utime_, last_input_);
  const auto place =
      std::lower_bound(input.queue.begin(), input.queue.end(), utime,
                       [](const Event& event, std::int64_t t) { return event.utime < t; });
  const bool repeated = (place != input.queue.end() && place->utime == utime) ||
                        (input.handed_out && utime <= *input.handed_out);
  input.newest = input.newest ? std::max(*input.newest, utime) : utime;
  if (turn_has_passed || repeated) return PushResult::kLate;
  input.queue.insert(place, {utime, std::move(handle)});
  newest_ = newest_ ? std::max(*newest_, utime) : utime;
  if (!first_) first_ = utime;
  release_if_in_vain();
  return PushResult::kQueued;
}

bool EventOrder::silent(const Input& input) const {
  if (input.is_feedback || !newest_) return input.is_silent;
  const std::int64_t reached = std::max(input.newest.value_or(*first_), *first_);
  return *newest_ > reached &&
         microseconds_between(reached, *newest_) > static_cast<std::uint64_t>(input.lag);
}

std::optional<std::size_t> EventOrder::oldest() const {
  std::optional<std::size_t> best;
  for (std::size_t i = 0; i < inputs_.size(); ++i) {
    if (inputs_[i].queue.empty()) continue;
    if (!best || inputs_[i].queue.front().utime < inputs_[*best].queue.front().utime) best = i;
  }
  return best;
}

const EventOrder::Input* EventOrder::blocking(std::size_t candidate) const {
  const std::int64_t utime = inputs_[candidate].queue.front().utime;
  for (const Input& input : inputs_) {
    if (input.is_feedback) continue;
    const bool passed = input.newest && *input.newest >= utime;
    if (!passed && !silent(input)) return &input;
  }
  return nullptr;
}

EventOrder::Event EventOrder::take(std::size_t number) {
  Input& input = inputs_[number];
  Event event = std::move(input.queue.front());
  input.queue.pop_front();
  input.handed_out = event.utime;
  last_utime_ = event.utime;
  last_input_ = number;
  any_handed_out_ = true;
  return event;
}

std::optional<EventOrder::Event> EventOrder::pop() {
  if (answer_) return std::exchange(answer_, std::nullopt);
  if (awaited_) return std::nullopt;
  const auto candidate = oldest();
  if (!candidate || blocking(*candidate) != nullptr) return std::nullopt;
  return take(*candidate);
}

std::optional<EventOrder::Event> EventOrder::drain() {
  if (answer_) return std::exchange(answer_, std::nullopt);
  awaited_.reset();
  const auto candidate = oldest();
  if (!candidate) return std::nullopt;
  return take(*candidate);
}

std::size_t EventOrder::keep_newest(int number) {
  if (awaited_) return 0;
  // Up to here every live input has passed.
  std::optional<std::int64_t> passed = newest_;
  for (const Input& input : inputs_) {
    if (!input.is_feedback && !silent(input)) passed = std::min(passed, input.newest);
  }
  auto& queue = inputs_[static_cast<std::size_t>(number)].queue;
  std::size_t dropped = 0;
  while (queue.size() > 1 && passed && queue[1].utime <= *passed) {
    queue.pop_front();
    ++dropped;
  }
  return dropped;
}

std::optional<std::int64_t> EventOrder::next_utime() const {
  const auto next = oldest();
  if (!next) return std::nullopt;
  return inputs_[*next].queue.front().utime;
}

std::string EventOrder::blocker() const {
  const auto candidate = oldest();
  if (answer_ || !candidate) return {};
  if (awaited_) return inputs_[awaited_input_].name;
  const Input* input = blocking(*candidate);
  return input != nullptr ? input->name : std::string();
}

std::vector<std::string> EventOrder::silent_inputs() const {
  std::vector<std::string> names;
  for (const Input& input : inputs_) {
    if (silent(input)) names.push_back(input.name);
  }
  return names;
}

std::size_t EventOrder::pending() const {
  std::size_t total = answer_ ? 1 : 0;
  for (const Input& input : inputs_) total += input.queue.size();
  return total;
}

}  // namespace gastronaut

#include "bus/bus.hpp"

#include <algorithm>
#include <charconv>
#include <limits>
#include <memory>

namespace gastronaut {
namespace {
constexpr double kMicroseconds = 1e6;  // a second
}  // namespace

std::size_t Bus::add_input(const std::string& channel, double lag, Overload overload) {
  order_.add_input(channel, static_cast<std::int64_t>(lag * kMicroseconds));
  Input input;
  input.channel = channel;
  input.overload = overload;
  inputs_.push_back(std::move(input));
  return inputs_.size() - 1;
}

std::size_t Bus::add_feedback(const std::string& channel, double lag) {
  order_.add_feedback(channel, static_cast<std::int64_t>(lag * kMicroseconds));
  Input input;
  input.channel = channel;
  inputs_.push_back(std::move(input));
  return inputs_.size() - 1;
}

bool Bus::await(const std::string& channel, std::int64_t utime) {
  const auto input = std::find_if(inputs_.begin(), inputs_.end(),
                                  [&](const Input& other) { return other.channel == channel; });
  return order_.await(static_cast<int>(input - inputs_.begin()), utime);
}

void Bus::set_health(ProcessState state, std::string message) {
  state_ = state;
  message_ = std::move(message);
}

void Bus::receive(const std::string& channel, Bytes payload) {
  const auto decoder = decoders_.find(channel);
  if (decoder == decoders_.end()) return;
  ++counters_.received;
  decoder->second(payload);
}

bool Bus::accept(DecodeResult result, std::size_t number) {
  if (result == DecodeResult::kOk) return true;
  ++(result == DecodeResult::kForeign ? counters_.foreign : counters_.corrupt);
  ++inputs_[number].bad;
  return false;
}

std::optional<std::int64_t> Bus::parse_seq(const std::string& text) {
  std::int64_t seq = 0;
  const char* end = text.data() + text.size();
  const auto [parsed_to, error] = std::from_chars(text.data(), end, seq);
  // Numbers so large that the next one is none are no sequence.
  if (error != std::errc() || parsed_to != end || seq < 0 ||
      seq == std::numeric_limits<std::int64_t>::max()) {
    return std::nullopt;
  }
  return seq;
}

void Bus::count_gap(std::size_t number, std::int64_t seq) {
  Input& input = inputs_[number];
  // A source that starts again counts from zero: no loss. Out of order is late, not lost.
  if (input.seen && seq > input.next_seq) counters_.lost += seq - input.next_seq;
  input.seen = true;
  input.next_seq = seq + 1;
}

void Bus::push(std::size_t number, std::int64_t utime, EventOrder::Action action) {
  switch (order_.push(static_cast<int>(number), utime, std::move(action))) {
    case EventOrder::PushResult::kQueued:
      break;
    case EventOrder::PushResult::kLate:
      ++counters_.late;
      break;
    case EventOrder::PushResult::kImplausible:
      ++counters_.corrupt;
      ++inputs_[number].bad;
      break;
  }
}

bool Bus::handle(std::optional<EventOrder::Event> event) {
  if (!event) return false;
  event_utime_ = event->utime;
  event->handle();
  return true;
}

bool Bus::handle_next() { return handle(order_.pop()); }

bool Bus::handle_remaining() { return handle(order_.drain()); }

void Bus::skip_to_newest() {
  for (std::size_t i = 0; i < inputs_.size(); ++i) {
    if (inputs_[i].overload != Overload::kKeepNewest) continue;
    counters_.dropped += static_cast<std::int64_t>(order_.keep_newest(static_cast<int>(i)));
  }
}

std::string Bus::describe_health() const {
  std::string text = message_;
  const auto add = [&text](const std::string& more) { text += (text.empty() ? "" : "; ") + more; };
  for (const Input& input : inputs_) {
    if (input.bad > 0) {
      add(input.channel + ": " + std::to_string(input.bad) +
          " corrupt or foreign messages dropped");
    }
  }
  for (const std::string& name : order_.silent_inputs()) {
    add(name + " is silent: is its source running?");
  }
  const std::string blocker = order_.blocker();
  if (!blocker.empty()) add("waiting for " + blocker);
  return text;
}

}  // namespace gastronaut

// Any sequence of messages and reads: handed out once and in order, or accounted for.
#include <fuzzer/FuzzedDataProvider.h>

#include <limits>
#include <map>
#include <optional>
#include <utility>

#include "bus/event_order.hpp"
#include "fuzz_check.hpp"

using namespace gastronaut;

namespace {

class Checker {
 public:
  explicit Checker(FuzzedDataProvider& data) : data_(data) {
    const int inputs = data_.ConsumeIntegralInRange(1, 4);
    for (int i = 0; i < inputs; ++i) {
      lags_.push_back(data_.ConsumeIntegralInRange<std::int64_t>(0, 2'000'000));
      order_.add_input("input" + std::to_string(i), lags_.back());
    }
    feedback_ =
        order_.add_feedback("feedback", data_.ConsumeIntegralInRange<std::int64_t>(0, 1'000'000));
  }

  void run() {
    while (data_.remaining_bytes() > 0) {
      switch (data_.ConsumeIntegralInRange(0, 10)) {
        case 8:
          await(data_.ConsumeBool() ? last_.first : now_);
          break;
        case 9:
          // May be at the end of the numbers, and wrap.
          answer(static_cast<std::int64_t>(
              static_cast<std::uint64_t>(awaited_.value_or(now_)) +
              static_cast<std::uint64_t>(data_.ConsumeIntegralInRange<std::int64_t>(-2, 2))));
          break;
        case 10:
          answer(data_.ConsumeIntegral<std::int64_t>());
          break;
        case 0:
          take(order_.drain());
          break;
        case 1:
        case 2:
          pop();
          break;
        case 3:
          dropped_ += order_.keep_newest(input());
          break;
        case 4:
          push(input(), data_.ConsumeIntegral<std::int64_t>());
          break;
        default:
          // As a rig sends: mostly forwards.
          now_ += data_.ConsumeIntegralInRange<std::int64_t>(-50'000, 200'000);
          push(input(), now_);
      }
      promise(order_.pending() == queued_ - handed_out_ - dropped_, "no event gets lost");
    }
    while (take(order_.drain())) continue;
    promise(handed_out_ + dropped_ == queued_, "draining hands out everything");
  }

 private:
  int input() { return data_.ConsumeIntegralInRange(0, static_cast<int>(lags_.size()) - 1); }

  void push(int input, std::int64_t utime) {
    const auto result = order_.push(input, utime, [this, input, utime] {
      called_ = {utime, input};
    });
    if (result == EventOrder::PushResult::kQueued) {
      ++queued_;
      promise(last_ < std::pair(utime, input), "what is queued is still to come");
    }
  }

  void await(std::int64_t utime) {
    const std::size_t before = order_.pending();
    awaited_.reset();
    if (order_.await(feedback_, utime)) awaited_ = utime;
    dropped_ += before - order_.pending();
  }

  void answer(std::int64_t utime) {
    const std::size_t before = order_.pending();
    order_.push(feedback_, utime, [this, utime] { called_ = {utime, feedback_}; });
    if (order_.pending() == before) return;
    promise(awaited_ == utime, "only the answer that is awaited is kept");
    ++queued_;
  }

  void pop() {
    const bool waits = !order_.blocker().empty();
    const bool any = order_.pending() > 0;
    promise(take(order_.pop()) == (any && !waits), "an event waits for its blocker, and only so");
  }

  bool take(std::optional<EventOrder::Event> event) {
    if (!event) return false;
    ++handed_out_;
    event->handle();
    promise(called_.first == event->utime, "an event carries its own action");
    if (called_.second == feedback_) {
      promise(awaited_ == called_.first, "an answer is handed out while it is awaited");
      awaited_.reset();
      return true;
    }
    promise(last_ < called_, "events come in the order of utime and input, each once");
    last_ = called_;
    return true;
  }

  FuzzedDataProvider& data_;
  EventOrder order_;
  std::vector<std::int64_t> lags_;
  int feedback_ = 0;
  std::optional<std::int64_t> awaited_;  // unless it is known not to come
  std::int64_t now_ = 1'700'000'000'000'000;
  std::size_t queued_ = 0;
  std::size_t handed_out_ = 0;
  std::size_t dropped_ = 0;
  std::pair<std::int64_t, int> called_{};
  std::pair<std::int64_t, int> last_{std::numeric_limits<std::int64_t>::min(), -1};
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  FuzzedDataProvider data(bytes, size);
  Checker(data).run();
  return 0;
}

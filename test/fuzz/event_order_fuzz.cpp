// Any sequence of messages and reads: handed out once and in order, or accounted for.
#include <fuzzer/FuzzedDataProvider.h>

#include <limits>
#include <map>
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
  }

  void run() {
    while (data_.remaining_bytes() > 0) {
      switch (data_.ConsumeIntegralInRange(0, 7)) {
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
    promise(last_ < called_, "events come in the order of utime and input, each once");
    last_ = called_;
    return true;
  }

  FuzzedDataProvider& data_;
  EventOrder order_;
  std::vector<std::int64_t> lags_;
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

#include "can_hall_array/cycle_assembler.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace gastronaut {
namespace {

// A frame may be overtaken by frames of the next reading, not of the one after.
constexpr std::int64_t kOvertakenBy = 1;
// Frames so many readings old are late; anything older is a counter that began anew.
constexpr std::int64_t kLatest = 4;
// A jump ahead of so much more than the time that went by is one, too. The rate may be off by half.
constexpr double kRateTolerance = 2;
constexpr std::int64_t kJumpTolerance = 8;

}  // namespace

CycleAssembler::CycleAssembler(const Settings& settings, std::function<void(const Reading&)> handle)
    : settings_(settings), handle_(std::move(handle)) {}

std::optional<std::int64_t> CycleAssembler::number_of(std::uint64_t counter, std::int64_t utime) {
  const std::int64_t turn = std::int64_t{1} << settings_.counter_bits;
  const auto shown = static_cast<std::int64_t>(counter) & (turn - 1);
  if (!started_) {
    started_ = true;
    newest_ = shown;
    newest_counter_ = counter;
    newest_utime_ = utime;
    return newest_;
  }
  // How many readings ahead of the newest, by the counter and by the clock.
  const std::int64_t ahead =
      (shown - (static_cast<std::int64_t>(newest_counter_) & (turn - 1)) + turn) % turn;
  constexpr double kMostElapsed =
      1e9;  // readings: the numbers stay numbers, whatever the clocks do
  const double elapsed = std::clamp(
      (static_cast<double>(utime) - static_cast<double>(newest_utime_)) * 1e-6 * settings_.rate,
      0.0, kMostElapsed);
  const auto by_clock = std::llround(elapsed);
  std::int64_t steps = 0;
  if (by_clock < turn / 2) {
    steps = ahead <= turn / 2 ? ahead : ahead - turn;
  } else {
    steps = ahead + turn * std::max(0LL, std::llround(static_cast<double>(by_clock - ahead) /
                                                      static_cast<double>(turn)));
  }
  const bool backwards = steps < -std::min(kLatest, turn / 4);
  const bool jumped = static_cast<double>(steps) >
                      (1 + kRateTolerance) * elapsed + static_cast<double>(kJumpTolerance);
  if (backwards || jumped) {
    ++counters_.restarts;
    finish();
    steps = std::max<std::int64_t>(1, by_clock);
  }
  const std::int64_t number = newest_ + steps;
  if (number > newest_) {
    newest_ = number;
    newest_counter_ = counter;
    newest_utime_ = utime;
  }
  if (handed_out_ && number <= *handed_out_) return std::nullopt;
  return number;
}

void CycleAssembler::add(int part, std::uint64_t counter, std::int64_t utime,
                         std::span<const std::pair<std::size_t, double>> values) {
  const std::optional<std::int64_t> number = number_of(counter, utime);
  if (!number) {
    ++counters_.late;
    return;
  }
  const auto [at, is_new] = open_.try_emplace(*number);
  Open& open = at->second;
  if (is_new) {
    open.reading.utime = utime;
    open.reading.number = *number;
    open.reading.values.assign(settings_.num_values, std::numeric_limits<double>::quiet_NaN());
    open.arrived.assign(static_cast<std::size_t>(settings_.num_parts), false);
    open.missing = settings_.num_parts;
  }
  const auto index = static_cast<std::size_t>(part);
  if (open.arrived[index]) {
    ++counters_.duplicates;
    return;
  }
  open.arrived[index] = true;
  --open.missing;
  open.reading.utime = std::min(open.reading.utime, utime);
  for (const auto& [place, value] : values) open.reading.values[place] = value;
  hand_out_ready(utime);
}

void CycleAssembler::advance(std::int64_t utime) { hand_out_ready(utime); }

void CycleAssembler::hand_out_ready(std::int64_t now) {
  const auto timeout = std::llround(settings_.timeout * 1e6);
  while (!open_.empty()) {
    const Open& first = open_.begin()->second;
    const bool due =
        newest_ - first.reading.number > kOvertakenBy || now - first.reading.utime > timeout;
    if (first.missing > 0 && !due) return;
    hand_out_first();
  }
}

void CycleAssembler::finish() {
  while (!open_.empty()) hand_out_first();
}

void CycleAssembler::hand_out_first() {
  Open first = std::move(open_.begin()->second);
  open_.erase(open_.begin());
  first.reading.complete = first.missing == 0;
  ++(first.reading.complete ? counters_.complete : counters_.incomplete);
  if (handed_out_) counters_.lost += first.reading.number - *handed_out_ - 1;
  handed_out_ = first.reading.number;
  handle_(first.reading);
}

}  // namespace gastronaut

// Puts a reading together again from the frames that it was sent in. They carry its number, modulo
// the width of their cycle counter; what has not come by the time that the reading is due is left
// out of it and never filled in from another reading.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <span>
#include <utility>
#include <vector>

namespace gastronaut {

class CycleAssembler {
 public:
  struct Settings {
    int num_parts = 1;  // frames of a reading
    std::size_t num_values = 0;
    int counter_bits = 16;
    double rate = 100;      // readings a second: bridges silences longer than the counter's turn
    double timeout = 0.02;  // seconds from a reading's first frame until it is due
  };
  struct Reading {
    std::int64_t utime = 0;   // of its first frame
    std::int64_t number = 0;  // counts on where the counter wraps; a gap is a lost reading
    bool complete = false;
    std::vector<double> values;  // NaN (kNotArrived): has not come
  };
  struct Counters {
    std::int64_t complete = 0;
    std::int64_t incomplete = 0;  // handed out with values missing
    std::int64_t lost = 0;        // numbers of which nothing came
    std::int64_t duplicates = 0;  // frames that came twice; the first counts
    std::int64_t late = 0;        // frames of a reading that had been handed out
    std::int64_t restarts = 0;    // the counter began anew
  };

  // `handle` gets each reading once, by ascending number: as soon as it is complete and those
  // before it are out; incomplete, when a frame two numbers newer comes or after the timeout.
  CycleAssembler(const Settings& settings, std::function<void(const Reading&)> handle);

  // A frame of the reading numbered `counter` (modulo 2^counter_bits): part 0 to num_parts-1,
  // received at `utime`, with values at their places in the reading.
  void add(int part, std::uint64_t counter, std::int64_t utime,
           std::span<const std::pair<std::size_t, double>> values);
  // It is `utime` now, and no frame older than that is still to come.
  void advance(std::int64_t utime);
  // Hands out everything.
  void finish();

  const Counters& counters() const { return counters_; }

 private:
  struct Open {
    Reading reading;
    std::vector<bool> arrived;
    int missing = 0;
  };
  // Number of the reading that `counter` at `utime` stands for; nothing for a late frame.
  std::optional<std::int64_t> number_of(std::uint64_t counter, std::int64_t utime);
  void hand_out_ready(std::int64_t now);
  void hand_out_first();

  Settings settings_;
  std::function<void(const Reading&)> handle_;
  Counters counters_;
  std::map<std::int64_t, Open> open_;
  bool started_ = false;
  std::int64_t newest_ = 0;  // number, its counter and when it was first seen
  std::uint64_t newest_counter_ = 0;
  std::int64_t newest_utime_ = 0;
  std::optional<std::int64_t> handed_out_;  // the last number
};

}  // namespace gastronaut

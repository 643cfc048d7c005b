// From the times that files state to strictly ascending utimes.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "import/issues.hpp"
#include "import/table.hpp"

namespace gastronaut {

// `epoch` (seconds) plus `seconds`, in microseconds.
std::int64_t to_utime(double seconds, double epoch);

// Which of `utimes` to keep so that they strictly ascend and as few as possible are left out: one
// wild time costs itself and not everything that follows.
std::vector<std::size_t> longest_ascending(const std::vector<std::int64_t>& utimes);

// The same, each one left out reported as `where(index)`.
std::vector<std::size_t> forward_in_time(const std::vector<std::int64_t>& utimes, Issues& issues,
                                         const std::function<std::string(std::size_t)>& where);

// Readings of one sensor.
struct Series {
  std::size_t width = 0;             // numbers a reading
  std::vector<std::int64_t> utimes;  // microseconds, strictly ascending
  std::vector<std::int32_t> seqs;    // row numbers in the file, so that a bad row leaves a gap
  std::vector<float> values;         // reading by reading

  std::size_t size() const { return utimes.size(); }
};

// From a table whose first column is the time in seconds.
Series make_series(const Table& table, double epoch, const std::string& name, Issues& issues);

}  // namespace gastronaut

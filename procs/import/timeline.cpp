#include "import/timeline.hpp"

#include <algorithm>
#include <cmath>

namespace gastronaut {

std::int64_t to_utime(double seconds, double epoch) {
  // Some 30 000 years: the sum stays an integer number of microseconds, whatever a file states.
  constexpr double kFurthest = 1e12;
  return std::llround(std::clamp(epoch, -kFurthest, kFurthest) * 1e6) +
         std::llround(std::clamp(seconds, -kFurthest, kFurthest) * 1e6);
}

std::vector<std::size_t> longest_ascending(const std::vector<std::int64_t>& utimes) {
  // Patience sorting: tails[n] is the end of the best subsequence of length n + 1 so far.
  constexpr std::size_t kNone = static_cast<std::size_t>(-1);
  std::vector<std::size_t> tails;
  std::vector<std::size_t> before(utimes.size(), kNone);
  for (std::size_t i = 0; i < utimes.size(); ++i) {
    const auto place = std::lower_bound(
        tails.begin(), tails.end(), utimes[i],
        [&](std::size_t index, std::int64_t utime) { return utimes[index] < utime; });
    if (place != tails.begin()) before[i] = *(place - 1);
    if (place == tails.end()) {
      tails.push_back(i);
    } else if (utimes[i] != utimes[*place]) {  // of equal times the first stays
      *place = i;
    }
  }
  std::vector<std::size_t> kept(tails.size());
  std::size_t next = tails.empty() ? kNone : tails.back();
  for (std::size_t n = kept.size(); n-- > 0; next = before[next]) kept[n] = next;
  return kept;
}

std::vector<std::size_t> forward_in_time(const std::vector<std::int64_t>& utimes, Issues& issues,
                                         const std::function<std::string(std::size_t)>& where) {
  std::vector<std::size_t> kept = longest_ascending(utimes);
  std::size_t next = 0;
  for (std::size_t i = 0; i < utimes.size(); ++i) {
    if (next < kept.size() && kept[next] == i) {
      ++next;
    } else {
      issues.left_out(where(i) + ": the time does not go forward here; skipped");
    }
  }
  return kept;
}

Series make_series(const Table& table, double epoch, const std::string& name, Issues& issues) {
  std::vector<std::int64_t> utimes;
  for (std::size_t i = 0; i < table.rows(); ++i) {
    utimes.push_back(to_utime(table.row(i).front(), epoch));
  }
  Series series;
  series.width = table.columns - 1;
  for (const std::size_t i : forward_in_time(
           utimes, issues, [&](std::size_t row) { return place(name, table.lines[row]); })) {
    series.utimes.push_back(utimes[i]);
    series.seqs.push_back(static_cast<std::int32_t>(table.lines[i] - table.lines.front()));
    for (const double value : table.row(i).subspan(1)) {
      series.values.push_back(static_cast<float>(value));
    }
  }
  return series;
}

}  // namespace gastronaut

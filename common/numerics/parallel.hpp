// Loops over all cores whose results do not depend on how many cores there are: the range is cut
// into chunks of a fixed size, and partial results are joined in the order of the chunks.
#pragma once

#include <algorithm>
#include <cstddef>
#include <functional>
#include <utility>
#include <vector>

namespace gastronaut {

// Threads used by the loops below, for the whole program; 0 (the default): one a core.
// Call it before the loops start.
void set_thread_count(int threads);
// run(chunk) for each chunk in [0, chunks), on any thread, in any order.
void run_chunks(std::size_t chunks, const std::function<void(std::size_t)>& run);

// body(begin, end) over [0, count) in chunks of at most chunk_size. Chunks must be independent.
template <class Body>
void parallel_for_chunks(std::size_t count, std::size_t chunk_size, const Body& body) {
  const std::size_t chunks = (count + chunk_size - 1) / chunk_size;
  if (chunks <= 1) {
    if (count > 0) body(std::size_t{0}, count);
    return;
  }
  run_chunks(chunks, [&](std::size_t chunk) {
    const std::size_t begin = chunk * chunk_size;
    body(begin, std::min(begin + chunk_size, count));
  });
}

// join(...join(join(initial, r_0), r_1)..., r_n) with r_k = body(begin_k, end_k) of chunk k.
template <class Result, class Body, class Join>
Result parallel_reduce_in_order(std::size_t count, std::size_t chunk_size, Result initial,
                                const Body& body, const Join& join) {
  std::vector<Result> partial((count + chunk_size - 1) / chunk_size, initial);
  parallel_for_chunks(count, chunk_size, [&](std::size_t begin, std::size_t end) {
    partial[begin / chunk_size] = body(begin, end);
  });
  Result total = std::move(initial);
  for (Result& result : partial) total = join(std::move(total), std::move(result));
  return total;
}

}  // namespace gastronaut

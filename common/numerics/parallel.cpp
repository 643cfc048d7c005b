#include "numerics/parallel.hpp"

#include <tbb/parallel_for.h>
#include <tbb/task_arena.h>

#include <atomic>
#include <memory>
#include <thread>

namespace gastronaut {
namespace {

int thread_count = 0;

std::unique_ptr<tbb::task_arena>& arena() {
  static auto instance = std::make_unique<tbb::task_arena>();
  return instance;
}

#if defined(__SANITIZE_THREAD__)
// TBB's library is not instrumented: ThreadSanitizer cannot see how it orders its tasks, and would
// report every loop. Plain threads, which it understands, run the same chunks.
void run_on_plain_threads(std::size_t chunks, const std::function<void(std::size_t)>& run) {
  const unsigned count =
      thread_count > 0 ? static_cast<unsigned>(thread_count) : std::thread::hardware_concurrency();
  std::atomic<std::size_t> next{0};
  const auto work = [&] {
    for (std::size_t chunk = next++; chunk < chunks; chunk = next++) run(chunk);
  };
  std::vector<std::thread> threads;
  for (unsigned i = 1; i < count; ++i) threads.emplace_back(work);
  work();
  for (std::thread& thread : threads) thread.join();
}
#endif

}  // namespace

void set_thread_count(int threads) {
  thread_count = threads;
  arena() = threads > 0 ? std::make_unique<tbb::task_arena>(threads)
                        : std::make_unique<tbb::task_arena>();
}

void run_chunks(std::size_t chunks, const std::function<void(std::size_t)>& run) {
#if defined(__SANITIZE_THREAD__)
  run_on_plain_threads(chunks, run);
#else
  arena()->execute([&] { tbb::parallel_for(std::size_t{0}, chunks, run); });
#endif
}

}  // namespace gastronaut

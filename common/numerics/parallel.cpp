#include "numerics/parallel.hpp"

#include <memory>

namespace gastronaut {
namespace {
std::unique_ptr<tbb::task_arena>& arena() {
  static auto instance = std::make_unique<tbb::task_arena>();
  return instance;
}
}  // namespace

void set_thread_count(int threads) {
  arena() = threads > 0 ? std::make_unique<tbb::task_arena>(threads)
                        : std::make_unique<tbb::task_arena>();
}

tbb::task_arena& thread_arena() { return *arena(); }

}  // namespace gastronaut

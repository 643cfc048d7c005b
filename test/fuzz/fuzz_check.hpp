// What a fuzz target promises; a broken promise stops the run with the input that broke it.
#pragma once

#include <cstdio>
#include <cstdlib>

namespace gastronaut {

inline void promise(bool kept, const char* what) {
  if (kept) return;
  std::fprintf(stderr, "broken promise: %s\n", what);
  std::abort();
}

}  // namespace gastronaut

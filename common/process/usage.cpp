#include "process/usage.hpp"

#include <sys/resource.h>
#include <unistd.h>

#include <fstream>

namespace gastronaut {
namespace {

rusage usage() {
  rusage result{};
  getrusage(RUSAGE_SELF, &result);
  return result;
}

double seconds(const timeval& time) {
  return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
}

}  // namespace

double cpu_seconds() {
  const rusage used = usage();
  return seconds(used.ru_utime) + seconds(used.ru_stime);
}

std::int64_t resident_bytes() {
  std::ifstream statm("/proc/self/statm");  // in pages
  std::int64_t total = 0;
  std::int64_t resident = 0;
  statm >> total >> resident;
  return resident * sysconf(_SC_PAGESIZE);
}

std::int64_t peak_resident_bytes() {
  constexpr std::int64_t kKibibyte = 1024;
  return std::int64_t{usage().ru_maxrss} * kKibibyte;
}

}  // namespace gastronaut

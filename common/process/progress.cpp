#include "process/progress.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace gastronaut {
namespace {
constexpr std::chrono::milliseconds kRenewal{200};
constexpr double kTenths = 10;
}  // namespace

Progress::Progress(std::string what)
    : what_(std::move(what)),
      terminal_(isatty(STDERR_FILENO) != 0),
      start_(std::chrono::steady_clock::now()),
      last_(start_) {}

Progress::~Progress() {
  if (terminal_ && shown_) std::fputs("\r\033[K", stderr);
}

void Progress::update(double fraction) {
  fraction = std::clamp(fraction, 0.0, 1.0);
  const auto now = std::chrono::steady_clock::now();
  const int tenth = static_cast<int>(fraction * kTenths);
  if (terminal_ ? now - last_ < kRenewal : tenth <= last_tenth_) return;
  last_ = now;
  last_tenth_ = tenth;
  shown_ = true;
  const double elapsed = std::chrono::duration<double>(now - start_).count();
  const double left = fraction > 0 ? elapsed * (1 - fraction) / fraction : 0;
  std::fprintf(stderr, "%s%s: %3.0f %%, %.0f s, about %.0f s to go%s", terminal_ ? "\r\033[K" : "",
               what_.c_str(), fraction * 100, elapsed, left, terminal_ ? "" : "\n");
  std::fflush(stderr);
}

}  // namespace gastronaut

// Progress of long work on stderr: one line that renews itself on a terminal, a line every tenth
// elsewhere.
#pragma once

#include <chrono>
#include <string>

namespace gastronaut {

class Progress {
 public:
  explicit Progress(std::string what);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  // fraction 0..1 of the work is done. Cheap enough to call for every item.
  void update(double fraction);

 private:
  std::string what_;
  bool terminal_;
  bool shown_ = false;
  int last_tenth_ = 0;
  std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point last_;
};

}  // namespace gastronaut

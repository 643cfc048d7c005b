// What is wrong with a recording but does not stop its import: bad rows, broken pictures.
#pragma once

#include <cstddef>
#include <functional>
#include <string>
#include <utility>

namespace gastronaut {

class Issues {
 public:
  using Report = std::function<void(const std::string& what, std::size_t count)>;

  // `report` is called for every issue, as it is found, with how many there are by now.
  explicit Issues(Report report) : report_(std::move(report)) {}

  // Something that was left out, in words that name the file, and the line where there is one.
  void left_out(const std::string& what) { report_(what, ++count_); }
  std::size_t count() const { return count_; }

 private:
  Report report_;
  std::size_t count_ = 0;
};

}  // namespace gastronaut

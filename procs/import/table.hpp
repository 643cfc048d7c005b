// Tables of numbers as text: comma-separated or separated by blanks, one row a line. Empty lines
// and lines that start with # are not rows; a first row that does not start with a number is a
// header. Bad rows are named by file and line, left out and counted.
#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "import/issues.hpp"

namespace gastronaut {

// Calls row(line, cells) for every row but a header; `line` counts from 1.
void for_each_row(
    std::string_view text,
    const std::function<void(std::size_t line, std::span<const std::string_view> cells)>& row);

// The whole cell as a number; nothing for text, NaN, infinities and what no measurement can be.
std::optional<double> parse_number(std::string_view cell);

struct Table {
  std::size_t columns = 0;
  std::vector<double> values;      // row by row
  std::vector<std::size_t> lines;  // where each row stands in the file, from 1

  std::size_t rows() const { return lines.size(); }
  std::span<const double> row(std::size_t index) const {
    return std::span(values).subspan(index * columns, columns);
  }
};

// The rows that have exactly `columns` numbers.
Table parse_table(std::string_view text, std::size_t columns, const std::string& name,
                  Issues& issues);

// "FILE:LINE"
std::string place(const std::string& name, std::size_t line);

}  // namespace gastronaut

#include "import/table.hpp"

#include <charconv>
#include <cmath>

namespace gastronaut {
namespace {

constexpr std::string_view kBlanks = " \t\r";
// Beyond this no number in a recording is a measurement in SI units; it also fits a float.
constexpr double kLargestNumber = 1e30;

std::string_view trimmed(std::string_view text) {
  const std::size_t first = text.find_first_not_of(kBlanks);
  if (first == std::string_view::npos) return {};
  return text.substr(first, text.find_last_not_of(kBlanks) - first + 1);
}

void split(std::string_view line, std::vector<std::string_view>& cells) {
  cells.clear();
  if (line.find(',') != std::string_view::npos) {
    for (std::size_t comma = 0; comma != std::string_view::npos;) {
      comma = line.find(',');
      cells.push_back(trimmed(line.substr(0, comma)));
      if (comma != std::string_view::npos) line.remove_prefix(comma + 1);
    }
    return;
  }
  while (!line.empty()) {
    const std::size_t end = std::min(line.find_first_of(kBlanks), line.size());
    cells.push_back(line.substr(0, end));
    line.remove_prefix(std::min(line.find_first_not_of(kBlanks, end), line.size()));
  }
}

}  // namespace

void for_each_row(
    std::string_view text,
    const std::function<void(std::size_t line, std::span<const std::string_view> cells)>& row) {
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
  if (text.starts_with(kByteOrderMark)) text.remove_prefix(kByteOrderMark.size());
  std::vector<std::string_view> cells;
  bool first = true;
  for (std::size_t line = 1; !text.empty(); ++line) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    const std::string_view content = trimmed(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
    if (content.empty() || content.front() == '#') continue;
    split(content, cells);
    const bool header = first && !parse_number(cells.front());
    first = false;
    if (!header) row(line, cells);
  }
}

std::optional<double> parse_number(std::string_view cell) {
  if (cell.starts_with('+')) cell.remove_prefix(1);
  double number = 0;
  const auto [end, error] = std::from_chars(cell.data(), cell.data() + cell.size(), number);
  if (error != std::errc() || end != cell.data() + cell.size()) return std::nullopt;
  if (!(std::abs(number) <= kLargestNumber)) return std::nullopt;
  return number;
}

Table parse_table(std::string_view text, std::size_t columns, const std::string& name,
                  Issues& issues) {
  Table table;
  table.columns = columns;
  for_each_row(text, [&](std::size_t line, std::span<const std::string_view> cells) {
    if (cells.size() != columns) {
      issues.left_out(place(name, line) + ": " + std::to_string(cells.size()) +
                      " numbers instead of " + std::to_string(columns) + "; row skipped");
      return;
    }
    const std::size_t begin = table.values.size();
    for (const std::string_view cell : cells) {
      const auto number = parse_number(cell);
      if (!number) {
        constexpr std::size_t kShown = 40;
        issues.left_out(place(name, line) + ": '" + std::string(cell.substr(0, kShown)) +
                        "' is not a number; row skipped");
        table.values.resize(begin);
        return;
      }
      table.values.push_back(*number);
    }
    table.lines.push_back(line);
  });
  return table;
}

std::string place(const std::string& name, std::size_t line) {
  return name + ":" + std::to_string(line);
}

}  // namespace gastronaut

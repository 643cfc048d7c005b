#include "export/message_table.hpp"

#include <algorithm>
#include <bit>
#include <charconv>
#include <utility>
#include <vector>

namespace gastronaut {
namespace {

constexpr std::size_t kFingerprint = 8;
constexpr std::int64_t kMostElements = 512;
constexpr std::int64_t kMostBytes = 64;

std::size_t size_of(WireKind kind) {
  switch (kind) {
    case WireKind::kInt16:
      return 2;
    case WireKind::kInt32:
    case WireKind::kFloat:
      return 4;
    case WireKind::kInt64:
    case WireKind::kDouble:
      return 8;
    default:
      return 1;
  }
}

template <class Number>
std::string shortest(Number number) {
  std::array<char, 32> text{};
  const auto result = std::to_chars(text.data(), text.data() + text.size(), number);
  return {text.data(), result.ptr};
}

std::string quoted(const std::string& text) {
  if (text.find_first_of(",\"\r\n") == std::string::npos) return text;
  std::string result = "\"";
  for (const char letter : text) {
    if (letter == '"') result += '"';
    result += letter;
  }
  return result + '"';
}

std::string bytes_as_text(Bytes bytes) {
  const bool printable = std::all_of(bytes.begin(), bytes.end(),
                                     [](std::uint8_t byte) { return byte >= 0x20 && byte < 0x7F; });
  if (printable) return quoted({bytes.begin(), bytes.end()});
  constexpr const char* kDigits = "0123456789abcdef";
  std::string text = "0x";
  for (const std::uint8_t byte : bytes) {
    text += kDigits[byte >> 4];
    text += kDigits[byte & 0xF];
  }
  return text;
}

}  // namespace

// One walk over the layout, with a message or without: names columns, measures arrays, or writes
// cells, empty ones where the message has no such element.
class MessageTable::Walk {
 public:
  enum class Task { kMeasure, kNames, kCells };

  // `measured`: where to note the lengths; only for kMeasure.
  Walk(Task task, const std::map<std::string, Lengths>& longest, Bytes rest,
       std::map<std::string, Lengths>* measured = nullptr)
      : task_(task), longest_(longest), rest_(rest), measured_(measured) {}

  // `path` as in the map of lengths, `name` as in the columns.
  void walk(const WireLayout& layout, bool present, const std::string& path,
            const std::string& name) {
    std::vector<std::int64_t> counts(static_cast<std::size_t>(layout.num_fields), 0);
    for (int i = 0; i < layout.num_fields; ++i) {
      const WireField& field = layout.fields[i];
      const std::string field_path = path.empty() ? field.name : path + "." + field.name;
      const std::string field_name = name.empty() ? field.name : name + "_" + field.name;
      if (field.num_dimensions == 0) {
        counts[static_cast<std::size_t>(i)] = element(field, present, field_path, field_name);
        continue;
      }
      Lengths lengths = {0, 1};
      for (int d = 0; d < field.num_dimensions; ++d) {
        const WireDimension& dimension = field.dimensions[static_cast<std::size_t>(d)];
        lengths[static_cast<std::size_t>(d)] =
            dimension.field < 0 ? dimension.fixed
                                : counts[static_cast<std::size_t>(dimension.field)];
      }
      if (!present) lengths[0] = 0;
      array(field, lengths, field_path, field_name);
    }
  }

  std::string text() const { return text_; }

 private:
  void array(const WireField& field, const Lengths& lengths, const std::string& path,
             const std::string& name) {
    if (task_ == Task::kMeasure) {
      if (measured_ != nullptr) {
        Lengths& noted = measured_->try_emplace(path, Lengths{0, 0}).first->second;
        for (std::size_t d = 0; d < 2; ++d) noted[d] = std::max(noted[d], lengths[d]);
      }
      skip(field, lengths, path);
      return;
    }
    const auto known = longest_.find(path);
    const Lengths longest = known == longest_.end() ? Lengths{0, 0} : known->second;
    const bool is_bytes = field.kind == WireKind::kUint8 && field.num_dimensions == 1;
    if (is_bytes ? longest[0] > kMostBytes : longest[0] * longest[1] > kMostElements) {
      const Task task = std::exchange(task_, Task::kMeasure);
      skip(field, lengths, path);
      task_ = task;
      return;
    }
    if (is_bytes) {
      const auto count = static_cast<std::size_t>(lengths[0]);
      add(task_ == Task::kNames ? name : bytes_as_text(rest_.first(count)));
      rest_ = rest_.subspan(count);
      return;
    }
    for (std::int64_t i = 0; i < longest[0]; ++i) {
      for (std::int64_t k = 0; k < longest[1]; ++k) {
        std::string element_name = name + "_" + std::to_string(i);
        if (field.num_dimensions == 2) element_name += "_" + std::to_string(k);
        element(field, i < lengths[0] && k < lengths[1], path, element_name);
      }
    }
  }

  void skip(const WireField& field, const Lengths& lengths, const std::string& path) {
    const std::int64_t elements = lengths[0] * lengths[1];
    if (field.kind != WireKind::kStruct && field.kind != WireKind::kString) {
      rest_ = rest_.subspan(static_cast<std::size_t>(elements) * size_of(field.kind));
      return;
    }
    for (std::int64_t e = 0; e < elements; ++e) element(field, true, path, "");
  }

  // Its value, for those that count others.
  std::int64_t element(const WireField& field, bool present, const std::string& path,
                       const std::string& name) {
    if (field.kind == WireKind::kStruct) {
      walk(*field.nested, present, path, name);
      return 0;
    }
    if (task_ == Task::kNames) {
      add(name);
      return 0;
    }
    if (!present) {
      add("");
      return 0;
    }
    if (field.kind == WireKind::kString) {
      const auto length = static_cast<std::size_t>(bits(4));  // counts the closing zero
      const Bytes letters = rest_.first(length - 1);
      rest_ = rest_.subspan(length);
      add(quoted({letters.begin(), letters.end()}));
      return 0;
    }
    const std::uint64_t value = bits(size_of(field.kind));
    switch (field.kind) {
      case WireKind::kFloat:
        add(shortest(std::bit_cast<float>(static_cast<std::uint32_t>(value))));
        return 0;
      case WireKind::kDouble:
        add(shortest(std::bit_cast<double>(value)));
        return 0;
      default: {
        const int unused = 64 - 8 * static_cast<int>(size_of(field.kind));
        const std::int64_t number = field.kind == WireKind::kUint8
                                        ? static_cast<std::int64_t>(value)
                                        : static_cast<std::int64_t>(value << unused) >> unused;
        add(shortest(number));
        return number;
      }
    }
  }

  std::uint64_t bits(std::size_t size) {
    std::uint64_t value = 0;
    for (std::size_t i = 0; i < size; ++i) value = (value << 8) | rest_[i];
    rest_ = rest_.subspan(size);
    return value;
  }

  void add(const std::string& cell) {
    if (task_ == Task::kMeasure) return;
    if (!first_) text_ += ',';
    first_ = false;
    text_ += cell;
  }

  Task task_;
  const std::map<std::string, Lengths>& longest_;
  Bytes rest_;
  std::map<std::string, Lengths>* measured_;
  bool first_ = true;
  std::string text_;
};

void MessageTable::measure(Bytes payload) {
  Walk walk(Walk::Task::kMeasure, longest_, payload.subspan(kFingerprint), &longest_);
  walk.walk(layout_, true, "", "");
}

std::string MessageTable::header() const {
  Walk walk(Walk::Task::kNames, longest_, {});
  walk.walk(layout_, false, "", "");
  return walk.text();
}

std::string MessageTable::row(Bytes payload) const {
  Walk walk(Walk::Task::kCells, longest_, payload.subspan(kFingerprint));
  walk.walk(layout_, true, "", "");
  return walk.text();
}

}  // namespace gastronaut

// CAN databases (DBC): where in which frame a signal lies and what its counts mean. The subset that
// measuring devices need: messages, signals of both byte orders, signed, unsigned and floating
// point, one level of multiplexing. Comments, attributes, nodes and value tables are skipped.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace gastronaut {

enum class DbcValueType { kUnsigned, kSigned, kFloat, kDouble };

// value = counts * factor + offset, in `unit`.
struct DbcSignal {
  std::string name;
  int line = 0;  // in the file, from 1
  // The least significant bit (little endian) or the most significant one (big endian); bit n is
  // bit n % 8 of byte n / 8.
  int start_bit = 0;
  int num_bits = 1;  // 1 to 64
  bool little_endian = true;
  DbcValueType type = DbcValueType::kUnsigned;
  double factor = 1;
  double offset = 0;
  std::string unit;
  bool multiplexor = false;                // tells which of the multiplexed signals a frame carries
  std::optional<std::uint64_t> multiplex;  // in frames whose multiplexor says so; none: in all

  // Places of the signal's bits in the frame, least significant first.
  std::vector<int> bit_places() const;
  // `data` must hold all of the signal. Counts of signed signals are in two's complement with
  // num_bits bits; those of floating-point signals are their IEEE 754 bits.
  std::uint64_t counts(std::span<const std::uint8_t> data) const;
  void set_counts(std::span<std::uint8_t> data, std::uint64_t counts) const;
  double value(std::span<const std::uint8_t> data) const;
  // The nearest value that the signal can carry. `value` must not be NaN.
  void set_value(std::span<std::uint8_t> data, double value) const;
};

struct DbcMessage {
  std::uint32_t id = 0;
  bool extended = false;
  std::string name;
  int line = 0;
  int length = 0;  // bytes, up to 64
  std::vector<DbcSignal> signals;

  const DbcSignal* multiplexor() const;
};

// Throws ConfigurationError "NAME:LINE: what is wrong" for anything else than such a database:
// every signal lies within its message, names and identifiers are unique, numbers are finite.
std::vector<DbcMessage> parse_dbc(std::string_view text, const std::string& name);

// Throws ConfigurationError also when the file cannot be read.
std::vector<DbcMessage> load_dbc(const std::string& path);

}  // namespace gastronaut

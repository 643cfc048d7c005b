#include "can/dbc.hpp"

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <fstream>
#include <iterator>
#include <set>
#include <utility>

#include "can/can_frame.hpp"
#include "configuration/fields.hpp"

namespace gastronaut {
namespace {

constexpr int kMostBits = 64;

enum class TokenKind { kWord, kNumber, kText, kSign, kEnd };

struct Token {
  TokenKind kind = TokenKind::kEnd;
  std::string_view text;  // of kText: without the quotes
  int line = 0;
  bool starts_line = false;
  bool indented = false;
};

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n'; }
bool is_word(char c) {
  return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || c == '_' || is_digit(c);
}

class Parser {
 public:
  Parser(std::string_view text, std::string name) : name_(std::move(name)) { split(text); }

  // Statements begin at the first column; signals, on a line of their own.
  std::vector<DbcMessage> parse() {
    std::vector<DbcMessage> messages;
    bool any = false;   // message so far
    bool kept = false;  // the current one
    while (now().kind != TokenKind::kEnd) {
      const std::string_view keyword = now().text;
      if (keyword == "BO_") {
        kept = parse_message(messages);
        any = true;
      } else if (keyword == "SG_") {
        if (!any) fail("a signal before the first message (BO_)");
        DbcSignal signal = parse_signal();
        if (kept) add_signal(messages.back(), std::move(signal));
      } else if (keyword == "SIG_VALTYPE_") {
        parse_value_type(messages);
      } else if (keyword == "SG_MUL_VAL_") {
        fail("extended multiplexing is not understood; give each case a message of its own");
      } else {
        skip_statement();
      }
    }
    for (const DbcMessage& message : messages) check(message);
    return messages;
  }

 private:
  void split(std::string_view text) {
    int line = 1;
    bool starts_line = true;
    bool indented = false;
    std::size_t at = 0;
    while (at < text.size()) {
      const char c = text[at];
      if (is_space(c)) {
        if (c == '\n') {
          ++line;
          starts_line = true;
        }
        indented = c != '\n';
        ++at;
        continue;
      }
      Token token{TokenKind::kSign, text.substr(at, 1), line, starts_line, indented};
      std::size_t end = at + 1;
      if (c == '"') {
        token.kind = TokenKind::kText;
        while (end < text.size() && text[end] != '"') {
          if (text[end] == '\\' && end + 1 < text.size()) ++end;
          if (text[end] == '\n') ++line;
          ++end;
        }
        if (end >= text.size()) fail_at(token.line, "a text in quotes without its end");
        token.text = text.substr(at + 1, end - at - 1);
        ++end;
      } else if (is_digit(c) || ((c == '-' || c == '+' || c == '.') && end < text.size() &&
                                 (is_digit(text[end]) || text[end] == '.'))) {
        token.kind = TokenKind::kNumber;
        const auto is_exponent = [](char before) { return before == 'e' || before == 'E'; };
        while (end < text.size() &&
               (is_word(text[end]) || text[end] == '.' ||
                ((text[end] == '-' || text[end] == '+') && is_exponent(text[end - 1])))) {
          ++end;
        }
        token.text = text.substr(at, end - at);
      } else if (is_word(c)) {
        token.kind = TokenKind::kWord;
        while (end < text.size() && is_word(text[end])) ++end;
        token.text = text.substr(at, end - at);
      }
      tokens_.push_back(token);
      starts_line = false;
      indented = false;
      at = end;
    }
    tokens_.push_back({TokenKind::kEnd, "the end of the file", line, true, false});
  }

  [[noreturn]] void fail_at(int line, const std::string& problem) const {
    throw ConfigurationError(name_ + ":" + std::to_string(line) + ": " + problem);
  }
  [[noreturn]] void fail(const std::string& problem) const { fail_at(now().line, problem); }

  const Token& now() const { return tokens_[next_]; }
  bool at_sign(char sign) const {
    return now().kind == TokenKind::kSign && now().text.front() == sign;
  }
  void expect_sign(char sign) {
    if (!at_sign(sign)) {
      fail(std::string("expected '") + sign + "' instead of '" + std::string(now().text) + "'");
    }
    ++next_;
  }
  std::string expect_word(const char* what) {
    if (now().kind != TokenKind::kWord) {
      fail(std::string("expected ") + what + " instead of '" + std::string(now().text) + "'");
    }
    return std::string(tokens_[next_++].text);
  }
  template <class Number>
  Number expect_number(const char* what) {
    std::string_view text = now().text;
    if (!text.empty() && text.front() == '+') text.remove_prefix(1);
    Number number{};
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    bool good = now().kind == TokenKind::kNumber && error == std::errc() &&
                end == text.data() + text.size();
    if constexpr (std::is_floating_point_v<Number>) good = good && std::isfinite(number);
    if (!good) {
      fail(std::string("expected ") + what + " instead of '" + std::string(now().text) + "'");
    }
    ++next_;
    return number;
  }

  void skip_statement() {
    do {
      ++next_;
    } while (now().kind != TokenKind::kEnd && !(now().starts_line && !now().indented) &&
             !(now().starts_line && now().text == "SG_"));
  }

  // False for Vector's container of signals that are in no message.
  bool parse_message(std::vector<DbcMessage>& messages) {
    constexpr std::uint32_t kExtended = 0x80000000;
    constexpr std::uint32_t kNoMessage = 0xC0000000;
    constexpr std::uint32_t kMostStandard = 0x7FF;
    constexpr std::uint32_t kMostExtended = 0x1FFFFFFF;
    DbcMessage message;
    message.line = now().line;
    ++next_;
    const auto id = expect_number<std::uint32_t>("a message's identifier");
    message.extended = (id & kExtended) != 0;
    message.id = id & ~kExtended;
    if (id != kNoMessage && message.id > (message.extended ? kMostExtended : kMostStandard)) {
      fail("there is no CAN identifier " + std::to_string(id));
    }
    message.name = expect_word("a message's name");
    expect_sign(':');
    message.length = expect_number<int>("a message's length");
    if (message.length < 0 || message.length > static_cast<int>(kMostCanBytes)) {
      fail(message.name + ": a CAN frame has 0 to 64 bytes, not " + std::to_string(message.length));
    }
    skip_statement_from_here();
    if (id == kNoMessage) return false;
    if (!identifiers_.insert(id).second) {
      fail_at(message.line,
              message.name + ": another message has the identifier " + std::to_string(message.id));
    }
    messages.push_back(std::move(message));
    return true;
  }

  // The rest of the statement says nothing that is needed: sender, receivers.
  void skip_statement_from_here() {
    --next_;
    skip_statement();
  }

  DbcSignal parse_signal() {
    DbcSignal signal;
    signal.line = now().line;
    ++next_;
    signal.name = expect_word("a signal's name");
    if (!at_sign(':')) parse_multiplexing(signal);
    expect_sign(':');
    signal.start_bit = expect_number<int>("the start bit");
    expect_sign('|');
    signal.num_bits = expect_number<int>("the number of bits");
    constexpr int kMostStart = 8 * static_cast<int>(kMostCanBytes) - 1;
    if (signal.num_bits < 1 || signal.num_bits > kMostBits) {
      fail(signal.name + ": a signal has 1 to 64 bits, not " + std::to_string(signal.num_bits));
    }
    if (signal.start_bit < 0 || signal.start_bit > kMostStart) {
      fail(signal.name + ": a frame has no bit " + std::to_string(signal.start_bit));
    }
    expect_sign('@');
    const int order = expect_number<int>("the byte order, 0 or 1");
    if (order != 0 && order != 1) fail(signal.name + ": the byte order is 0 or 1");
    signal.little_endian = order == 1;
    if (at_sign('-')) {
      signal.type = DbcValueType::kSigned;
    } else if (!at_sign('+')) {
      fail(signal.name + ": expected + (unsigned) or - (signed)");
    }
    ++next_;
    expect_sign('(');
    signal.factor = expect_number<double>("the factor");
    if (signal.factor == 0) fail(signal.name + ": a factor of 0 carries nothing");
    expect_sign(',');
    signal.offset = expect_number<double>("the offset");
    expect_sign(')');
    expect_sign('[');
    expect_number<double>("the minimum");
    expect_sign('|');
    expect_number<double>("the maximum");
    expect_sign(']');
    if (now().kind != TokenKind::kText) fail(signal.name + ": expected the unit in quotes");
    signal.unit = std::string(now().text);
    ++next_;
    skip_statement_from_here();
    return signal;
  }

  void parse_multiplexing(DbcSignal& signal) {
    const std::string word = expect_word("M, m and a number, or ':'");
    if (word == "M") {
      signal.multiplexor = true;
      return;
    }
    std::uint64_t value = 0;
    const char* const last = word.data() + word.size();
    const auto [end, error] = std::from_chars(word.data() + 1, last, value);
    if (word.front() == 'm' && error == std::errc() && end != last && *end == 'M') {
      fail("extended multiplexing is not understood; give each case a message of its own");
    }
    if (word.front() != 'm' || error != std::errc() || end != last) {
      fail("expected M, m and a number, or ':' instead of '" + word + "'");
    }
    signal.multiplex = value;
  }

  void add_signal(DbcMessage& message, DbcSignal signal) const {
    for (const DbcSignal& other : message.signals) {
      if (other.name == signal.name) {
        fail_at(signal.line, message.name + " has two signals " + signal.name);
      }
      if (other.multiplexor && signal.multiplexor) {
        fail_at(signal.line, message.name + " has two multiplexors");
      }
    }
    for (const int place : signal.bit_places()) {
      if (place < 8 * message.length) continue;
      fail_at(signal.line, signal.name + " does not lie within the " +
                               std::to_string(message.length) + " bytes of " + message.name);
    }
    message.signals.push_back(std::move(signal));
  }

  // SIG_VALTYPE_ 256 current : 1;
  void parse_value_type(std::vector<DbcMessage>& messages) {
    ++next_;
    const auto id = expect_number<std::uint32_t>("a message's identifier");
    const std::string name = expect_word("a signal's name");
    if (at_sign(':')) ++next_;
    const int type = expect_number<int>("1 (float) or 2 (double)");
    for (DbcMessage& message : messages) {
      if ((message.id | (message.extended ? 0x80000000U : 0U)) != id) continue;
      for (DbcSignal& signal : message.signals) {
        if (signal.name != name) continue;
        if (type == 0) continue;
        const int wanted_bits = type == 1 ? 32 : 64;
        if (type < 0 || type > 2 || signal.num_bits != wanted_bits) {
          fail(name + ": a float has 32 bits (type 1), a double 64 (type 2)");
        }
        signal.type = type == 1 ? DbcValueType::kFloat : DbcValueType::kDouble;
      }
    }
    skip_statement_from_here();
  }

  void check(const DbcMessage& message) const {
    const DbcSignal* multiplexor = message.multiplexor();
    if (multiplexor != nullptr && multiplexor->type != DbcValueType::kUnsigned) {
      fail_at(multiplexor->line, multiplexor->name + ": a multiplexor is an unsigned number");
    }
    for (const DbcSignal& signal : message.signals) {
      if (!signal.multiplex) continue;
      if (multiplexor == nullptr) {
        fail_at(signal.line,
                signal.name + " is multiplexed, but " + message.name + " has no multiplexor (M)");
      }
      if (multiplexor->num_bits < kMostBits && *signal.multiplex >> multiplexor->num_bits != 0) {
        fail_at(signal.line, signal.name + ": the multiplexor " + multiplexor->name + " is never " +
                                 std::to_string(*signal.multiplex));
      }
    }
  }

  std::string name_;
  std::vector<Token> tokens_;
  std::size_t next_ = 0;
  std::set<std::uint32_t> identifiers_;
};

std::uint64_t all_bits(int num_bits) {
  return num_bits == kMostBits ? ~std::uint64_t{0} : (std::uint64_t{1} << num_bits) - 1;
}

}  // namespace

std::vector<int> DbcSignal::bit_places() const {
  std::vector<int> places;
  int place = start_bit;
  for (int bit = 0; bit < num_bits; ++bit) {
    places.push_back(place);
    if (little_endian) {
      ++place;
    } else {
      place = place % 8 == 0 ? place + 15 : place - 1;  // on to the next byte's top bit
    }
  }
  if (!little_endian) std::reverse(places.begin(), places.end());
  return places;
}

std::uint64_t DbcSignal::counts(std::span<const std::uint8_t> data) const {
  std::uint64_t counts = 0;
  int place = start_bit;
  for (int bit = 0; bit < num_bits; ++bit) {
    const std::uint64_t set = (data[static_cast<std::size_t>(place / 8)] >> (place % 8)) & 1U;
    if (little_endian) {
      counts |= set << bit;
      ++place;
    } else {
      counts = counts << 1 | set;
      place = place % 8 == 0 ? place + 15 : place - 1;
    }
  }
  return counts;
}

void DbcSignal::set_counts(std::span<std::uint8_t> data, std::uint64_t counts) const {
  const std::vector<int> places = bit_places();
  for (std::size_t bit = 0; bit < places.size(); ++bit) {
    std::uint8_t& byte = data[static_cast<std::size_t>(places[bit] / 8)];
    const auto mask = static_cast<std::uint8_t>(1U << (places[bit] % 8));
    byte = static_cast<std::uint8_t>((counts >> bit & 1U) != 0 ? byte | mask : byte & ~mask);
  }
}

double DbcSignal::value(std::span<const std::uint8_t> data) const {
  const std::uint64_t bits = counts(data);
  switch (type) {
    case DbcValueType::kFloat:
      return static_cast<double>(std::bit_cast<float>(static_cast<std::uint32_t>(bits))) * factor +
             offset;
    case DbcValueType::kDouble:
      return std::bit_cast<double>(bits) * factor + offset;
    case DbcValueType::kSigned: {
      const bool negative = (bits >> (num_bits - 1) & 1U) != 0;
      const auto extended = static_cast<std::int64_t>(negative ? bits | ~all_bits(num_bits) : bits);
      return static_cast<double>(extended) * factor + offset;
    }
    default:
      return static_cast<double>(bits) * factor + offset;
  }
}

void DbcSignal::set_value(std::span<std::uint8_t> data, double value) const {
  const double wanted = (value - offset) / factor;
  if (type == DbcValueType::kFloat) {
    return set_counts(data, std::bit_cast<std::uint32_t>(static_cast<float>(wanted)));
  }
  if (type == DbcValueType::kDouble) return set_counts(data, std::bit_cast<std::uint64_t>(wanted));
  const bool is_signed = type == DbcValueType::kSigned;
  const std::uint64_t most = is_signed ? all_bits(num_bits) >> 1 : all_bits(num_bits);
  const double rounded = std::round(wanted);
  if (rounded >= static_cast<double>(most)) return set_counts(data, most);
  const double least = is_signed ? -std::ldexp(1.0, num_bits - 1) : 0.0;
  if (rounded <= least) return set_counts(data, is_signed ? most + 1 : 0);
  set_counts(data, is_signed ? static_cast<std::uint64_t>(static_cast<std::int64_t>(rounded))
                             : static_cast<std::uint64_t>(rounded));
}

const DbcSignal* DbcMessage::multiplexor() const {
  for (const DbcSignal& signal : signals) {
    if (signal.multiplexor) return &signal;
  }
  return nullptr;
}

std::vector<DbcMessage> parse_dbc(std::string_view text, const std::string& name) {
  return Parser(text, name).parse();
}

std::vector<DbcMessage> load_dbc(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  if (!file.good() && !file.eof()) {
    throw ConfigurationError(path + ": the CAN database cannot be read");
  }
  return parse_dbc(text, path);
}

}  // namespace gastronaut

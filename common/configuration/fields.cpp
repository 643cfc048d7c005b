#include "configuration/fields.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <numbers>
#include <numeric>
#include <sstream>

namespace gastronaut {
namespace {

struct Unit {
  const char* name;
  Dimension dimension;
  double in_si;
};

constexpr std::array<Unit, 25> kUnits = {{
    {"m", Dimension::kLength, 1},
    {"cm", Dimension::kLength, 1e-2},
    {"mm", Dimension::kLength, 1e-3},
    {"um", Dimension::kLength, 1e-6},
    {"s", Dimension::kTime, 1},
    {"ms", Dimension::kTime, 1e-3},
    {"us", Dimension::kTime, 1e-6},
    {"min", Dimension::kTime, 60},
    {"rad", Dimension::kAngle, 1},
    {"deg", Dimension::kAngle, std::numbers::pi / 180},
    {"Hz", Dimension::kFrequency, 1},
    {"kHz", Dimension::kFrequency, 1e3},
    {"T", Dimension::kMagneticField, 1},
    {"mT", Dimension::kMagneticField, 1e-3},
    {"uT", Dimension::kMagneticField, 1e-6},
    {"nT", Dimension::kMagneticField, 1e-9},
    {"G", Dimension::kMagneticField, 1e-4},
    {"mG", Dimension::kMagneticField, 1e-7},
    {"A", Dimension::kCurrent, 1},
    {"mA", Dimension::kCurrent, 1e-3},
    {"A.m2", Dimension::kMagneticMoment, 1},
    {"A*m^2", Dimension::kMagneticMoment, 1},
    {"T/A", Dimension::kFieldPerCurrent, 1},
    {"mT/A", Dimension::kFieldPerCurrent, 1e-3},
    {"uT/A", Dimension::kFieldPerCurrent, 1e-6},
}};

struct DimensionName {
  Dimension dimension;
  const char* quantity;
};
constexpr std::array<DimensionName, 9> kDimensionNames = {{
    {Dimension::kNone, "a plain number"},
    {Dimension::kLength, "a length in metres"},
    {Dimension::kTime, "a time in seconds"},
    {Dimension::kAngle, "an angle in radians"},
    {Dimension::kFrequency, "a frequency in hertz"},
    {Dimension::kMagneticField, "a magnetic field in tesla"},
    {Dimension::kCurrent, "a current in ampere"},
    {Dimension::kMagneticMoment, "a magnetic moment in A m^2"},
    {Dimension::kFieldPerCurrent, "a field per current in T/A"},
}};

std::string quantity(Dimension dimension) {
  for (const auto& name : kDimensionNames) {
    if (name.dimension == dimension) return name.quantity;
  }
  return "a number";
}

std::string units_of(Dimension dimension) {
  std::string units;
  for (const Unit& unit : kUnits) {
    if (unit.dimension == dimension) units += (units.empty() ? "" : ", ") + std::string(unit.name);
  }
  return units;
}

// Shortest text that reads back as the same double.
std::string shortest(double value) {
  std::array<char, 32> text{};
  const auto end = std::to_chars(text.data(), text.data() + text.size(), value);
  return {text.data(), end.ptr};
}

std::size_t edit_distance(const std::string& a, const std::string& b) {
  std::vector<std::size_t> row(b.size() + 1);
  std::iota(row.begin(), row.end(), std::size_t{0});
  for (std::size_t i = 0; i < a.size(); ++i) {
    std::size_t diagonal = row[0]++;
    for (std::size_t j = 0; j < b.size(); ++j) {
      const std::size_t substitution = diagonal + (a[i] == b[j] ? 0 : 1);
      diagonal = row[j + 1];
      row[j + 1] = std::min({substitution, row[j] + 1, row[j + 1] + 1});
    }
  }
  return row.back();
}

std::string describe_range(const Constraint& c) {
  const bool low = std::isfinite(c.minimum);
  const bool high = std::isfinite(c.maximum);
  if (low && high) return "between " + shortest(c.minimum) + " and " + shortest(c.maximum);
  if (low) return (c.exclusive_minimum ? "greater than " : "at least ") + shortest(c.minimum);
  return "at most " + shortest(c.maximum);
}

}  // namespace

FieldReader::FieldReader(const YAML::Node& map, std::string path)
    : map_(map), path_(std::move(path)) {
  if (map_.IsNull()) map_ = YAML::Node(YAML::NodeType::Map);
  if (!map_.IsMap()) fail("", "must be a map of keys and values");
  for (auto entry = map_.begin(); entry != map_.end(); ++entry) {
    if (!entry->first.IsScalar()) fail("", "has a key that is not a word");
    for (auto other = map_.begin(); other != entry; ++other) {
      if (other->first.Scalar() == entry->first.Scalar()) {
        fail(entry->first.Scalar(), "is given twice");
      }
    }
  }
}

std::string FieldReader::child_path(const char* key) const {
  return path_.empty() ? key : path_ + "." + key;
}

void FieldReader::fail(const std::string& key, const std::string& problem) const {
  YAML::Mark mark = map_.Mark();
  if (!key.empty()) {
    for (const auto& entry : map_) {
      if (entry.first.IsScalar() && entry.first.Scalar() == key) mark = entry.first.Mark();
    }
  }
  std::ostringstream text;
  if (!mark.is_null()) text << mark.line + 1 << ":";
  const std::string where = key.empty() ? path_ : child_path(key.c_str());
  text << " " << (where.empty() ? "" : where + ": ") << problem;
  throw ConfigurationError(text.str());
}

bool FieldReader::take(const char* key) {
  known_.emplace_back(key);
  const YAML::Node value = map_[key];
  return value.IsDefined() && !value.IsNull();
}

void FieldReader::read_word(const char* key, std::string& word) const {
  const YAML::Node node = map_[key];
  if (!node.IsScalar()) fail(key, "must be a single word");
  word = node.Scalar();
}

double FieldReader::number(const YAML::Node& node, const char* key, Constraint c) const {
  if (!node.IsScalar()) fail(key, "must be " + quantity(c.dimension));
  const std::string& text = node.Scalar();
  const char* begin = text.c_str();
  const char* end = begin + text.size();
  if (begin != end && *begin == '+') ++begin;
  double value = 0;
  const auto parsed = std::from_chars(begin, end, value);
  if (parsed.ec != std::errc() || !std::isfinite(value)) {
    fail(key, "'" + text + "' is not " + quantity(c.dimension));
  }
  std::string unit(parsed.ptr, end);
  unit.erase(0, unit.find_first_not_of(' ') == std::string::npos ? unit.size()
                                                                 : unit.find_first_not_of(' '));
  if (!unit.empty()) {
    const auto* found =
        std::find_if(kUnits.begin(), kUnits.end(), [&](const Unit& u) { return unit == u.name; });
    if (found == kUnits.end() || found->dimension != c.dimension) {
      const std::string right = units_of(c.dimension);
      fail(key, "'" + text + "' has the wrong unit: this is " + quantity(c.dimension) +
                    (right.empty() ? ", without a unit" : "; right are " + right));
    }
    value *= found->in_si;
  }
  if (value < c.minimum || value > c.maximum || (c.exclusive_minimum && value == c.minimum)) {
    fail(key, "'" + text + "' is impossible: must be " + quantity(c.dimension) + " " +
                  describe_range(c));
  }
  return value;
}

void FieldReader::operator()(const char* key, bool& value) {
  if (!take(key)) return;
  std::string word;
  read_word(key, word);
  if (word != "true" && word != "false") fail(key, "'" + word + "' is neither true nor false");
  value = word == "true";
}

void FieldReader::operator()(const char* key, int& value, Constraint constraint) {
  if (!take(key)) return;
  const double exact = number(map_[key], key, constraint);
  if (exact != std::floor(exact) || std::abs(exact) > std::numeric_limits<int>::max()) {
    fail(key, "'" + map_[key].Scalar() + "' is not a whole number");
  }
  value = static_cast<int>(exact);
}

void FieldReader::operator()(const char* key, std::uint64_t& value) {
  if (!take(key)) return;
  std::string word;
  read_word(key, word);
  const auto parsed = std::from_chars(word.data(), word.data() + word.size(), value);
  if (parsed.ec != std::errc() || parsed.ptr != word.data() + word.size()) {
    fail(key, "'" + word + "' is not a whole number from 0 to 2^64 - 1");
  }
}

void FieldReader::operator()(const char* key, double& value, Constraint constraint) {
  if (take(key)) value = number(map_[key], key, constraint);
}

void FieldReader::operator()(const char* key, std::string& value) {
  if (take(key)) read_word(key, value);
}

void FieldReader::operator()(const char* key, std::vector<double>& value, Constraint constraint) {
  if (!take(key)) return;
  const YAML::Node node = map_[key];
  if (!node.IsSequence()) fail(key, "must be a list of numbers");
  value.clear();
  for (const auto& element : node) value.push_back(number(element, key, constraint));
}

void FieldReader::operator()(const char* key, std::vector<int>& value, Constraint constraint) {
  std::vector<double> numbers(value.begin(), value.end());
  (*this)(key, numbers, constraint);
  value.clear();
  for (const double exact : numbers) {
    if (exact != std::floor(exact) || std::abs(exact) > std::numeric_limits<int>::max()) {
      fail(key, "must be a list of whole numbers");
    }
    value.push_back(static_cast<int>(exact));
  }
}

void FieldReader::operator()(const char* key, std::vector<std::string>& value) {
  if (!take(key)) return;
  const YAML::Node node = map_[key];
  if (!node.IsSequence()) fail(key, "must be a list of words");
  value.clear();
  for (const auto& element : node) {
    if (!element.IsScalar()) fail(key, "must be a list of words");
    value.push_back(element.Scalar());
  }
}

void FieldReader::operator()(const char* key, Eigen::Vector3d& value, Constraint constraint) {
  std::vector<double> numbers(value.data(), value.data() + 3);
  (*this)(key, numbers, constraint);
  if (numbers.size() != 3) fail(key, "must be a list of three numbers");
  value = Eigen::Vector3d(numbers[0], numbers[1], numbers[2]);
}

void FieldReader::operator()(const char* key, Eigen::MatrixXd& value, Constraint constraint) {
  if (!take(key)) return;
  const YAML::Node node = map_[key];
  if (!node.IsSequence()) fail(key, "must be a list of rows");
  const auto rows = static_cast<Eigen::Index>(node.size());
  Eigen::Index columns = 0;
  if (rows > 0 && node[0].IsSequence()) columns = static_cast<Eigen::Index>(node[0].size());
  Eigen::MatrixXd matrix(rows, columns);
  Eigen::Index row = 0;
  for (const auto& line : node) {
    if (!line.IsSequence() || static_cast<Eigen::Index>(line.size()) != columns) {
      fail(key, "row " + std::to_string(row + 1) + " must be a list of " + std::to_string(columns) +
                    " numbers, as the first row is");
    }
    Eigen::Index column = 0;
    for (const auto& element : line) matrix(row, column++) = number(element, key, constraint);
    ++row;
  }
  value = std::move(matrix);
}

void FieldReader::finish() const {
  for (const auto& entry : map_) {
    const std::string& key = entry.first.Scalar();
    if (std::find(known_.begin(), known_.end(), key) != known_.end()) continue;
    const auto nearest = std::min_element(known_.begin(), known_.end(),
                                          [&](const std::string& a, const std::string& b) {
                                            return edit_distance(a, key) < edit_distance(b, key);
                                          });
    std::string all;
    for (const std::string& name : known_) all += (all.empty() ? "" : ", ") + name;
    constexpr std::size_t kLikelyTypo = 3;
    const bool typo = nearest != known_.end() && edit_distance(*nearest, key) <= kLikelyTypo;
    fail(key,
         "unknown key; " + (typo ? "did you mean '" + *nearest + "'?" : "known here are: " + all));
  }
}

void FieldWriter::operator()(const char* key, const bool& value) {
  out_ << YAML::Key << key << YAML::Value << (value ? "true" : "false");
}
void FieldWriter::operator()(const char* key, const int& value, Constraint) {
  out_ << YAML::Key << key << YAML::Value << value;
}
void FieldWriter::operator()(const char* key, const std::uint64_t& value) {
  out_ << YAML::Key << key << YAML::Value << std::to_string(value);
}
void FieldWriter::operator()(const char* key, const double& value, Constraint) {
  out_ << YAML::Key << key << YAML::Value << shortest(value);
}
void FieldWriter::operator()(const char* key, const std::string& value) {
  out_ << YAML::Key << key << YAML::Value << value;
}
void FieldWriter::operator()(const char* key, const std::vector<double>& value, Constraint) {
  out_ << YAML::Key << key << YAML::Value << YAML::Flow << YAML::BeginSeq;
  for (const double element : value) out_ << shortest(element);
  out_ << YAML::EndSeq;
}
void FieldWriter::operator()(const char* key, const std::vector<int>& value, Constraint) {
  out_ << YAML::Key << key << YAML::Value << YAML::Flow << value;
}
void FieldWriter::operator()(const char* key, const std::vector<std::string>& value) {
  out_ << YAML::Key << key << YAML::Value << YAML::Flow << value;
}
void FieldWriter::operator()(const char* key, const Eigen::Vector3d& value, Constraint) {
  (*this)(key, std::vector<double>(value.data(), value.data() + 3));
}
void FieldWriter::operator()(const char* key, const Eigen::MatrixXd& value, Constraint) {
  if (value.size() == 0) return;
  out_ << YAML::Key << key << YAML::Value << YAML::BeginSeq;
  for (Eigen::Index row = 0; row < value.rows(); ++row) {
    out_ << YAML::Flow << YAML::BeginSeq;
    for (Eigen::Index column = 0; column < value.cols(); ++column) {
      out_ << shortest(value(row, column));
    }
    out_ << YAML::EndSeq;
  }
  out_ << YAML::EndSeq;
}

YamlSource parse_yaml(const std::string& text, const std::string& name) {
  try {
    return {YAML::Load(text), name};
  } catch (const YAML::Exception& error) {
    std::ostringstream message;
    message << name << ":";
    if (!error.mark.is_null())
      message << error.mark.line + 1 << ":" << error.mark.column + 1 << ":";
    message << " not YAML: " << error.msg;
    throw ConfigurationError(message.str());
  }
}

YamlSource load_yaml_file(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw ConfigurationError(path + ": cannot be opened; is the path right?");
  std::ostringstream text;
  text << file.rdbuf();
  if (!file && !file.eof()) throw ConfigurationError(path + ": cannot be read");
  return parse_yaml(text.str(), path);
}

void apply_setting(YAML::Node& root, const std::string& setting) {
  const ConfigurationError malformed("--set " + setting + ": must look like section.key=value");
  const std::size_t equals = setting.find('=');
  if (equals == std::string::npos || equals == 0) throw malformed;
  std::istringstream path(setting.substr(0, equals));
  std::vector<std::string> keys;
  for (std::string key; std::getline(path, key, '.');) {
    if (key.empty()) throw malformed;
    keys.push_back(key);
  }
  YAML::Node node = root;
  for (std::size_t i = 0; i + 1 < keys.size(); ++i) {
    if (!node[keys[i]].IsMap()) node[keys[i]] = YAML::Node(YAML::NodeType::Map);
    node.reset(node[keys[i]]);
  }
  node[keys.back()] = parse_yaml(setting.substr(equals + 1), "--set " + setting).root;
}

}  // namespace gastronaut

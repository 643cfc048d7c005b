// Configuration as plain structs: each lists its members once, in a `fields` function, and from
// that list come loading, checking, printing and `--set`. Values are SI; a length may also be
// written "22 mm", a field "1.5 uT", and a unit of the wrong kind is refused by name.
#pragma once

#include <yaml-cpp/yaml.h>

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

namespace gastronaut {

// What a user has to mend, with file and line where there is one: "rig.yaml:12: camera.fx: ...".
class ConfigurationError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

enum class Dimension {
  kNone,
  kLength,
  kTime,
  kAngle,
  kFrequency,
  kMagneticField,
  kCurrent,
  kMagneticMoment,
  kFieldPerCurrent,
};

// What a value has to be. `kNone` with the default range takes any finite number.
struct Constraint {
  Dimension dimension = Dimension::kNone;
  double minimum = -std::numeric_limits<double>::infinity();
  double maximum = std::numeric_limits<double>::infinity();
  bool exclusive_minimum = false;
};

constexpr Constraint any(Dimension dimension = Dimension::kNone) { return {dimension}; }
constexpr Constraint positive(Dimension dimension = Dimension::kNone) {
  return {dimension, 0, std::numeric_limits<double>::infinity(), true};
}
constexpr Constraint not_negative(Dimension dimension = Dimension::kNone) {
  return {dimension, 0, std::numeric_limits<double>::infinity()};
}
constexpr Constraint between(double minimum, double maximum,
                             Dimension dimension = Dimension::kNone) {
  return {dimension, minimum, maximum};
}

// One of a fixed set of words, for enumerations.
template <class Enum>
struct Choice {
  const char* word;
  Enum value;
};

// Reads a struct from a YAML map. Every key must be a field; missing keys keep their defaults.
class FieldReader {
 public:
  FieldReader(const YAML::Node& map, std::string path);

  void operator()(const char* key, bool& value);
  void operator()(const char* key, int& value, Constraint constraint = any());
  void operator()(const char* key, std::uint64_t& value);
  void operator()(const char* key, double& value, Constraint constraint = any());
  void operator()(const char* key, std::string& value);
  void operator()(const char* key, std::vector<double>& value, Constraint constraint = any());
  void operator()(const char* key, std::vector<int>& value, Constraint constraint = any());
  void operator()(const char* key, std::vector<std::string>& value);
  void operator()(const char* key, Eigen::Vector3d& value, Constraint constraint = any());
  // Rows of equal length.
  void operator()(const char* key, Eigen::MatrixXd& value, Constraint constraint = any());
  template <class Enum>
  void operator()(const char* key, Enum& value, const std::vector<Choice<Enum>>& choices) {
    std::string word;
    std::string words;
    for (const auto& choice : choices)
      words += (words.empty() ? "" : ", ") + std::string(choice.word);
    if (!take(key)) return;
    read_word(key, word);
    for (const auto& choice : choices) {
      if (word == choice.word) {
        value = choice.value;
        return;
      }
    }
    fail(key, "'" + word + "' is none of: " + words);
  }
  template <class Struct>
  void section(const char* key, Struct& value) {
    if (!take(key)) return;
    FieldReader reader(map_[key], child_path(key));
    value.fields(reader);
    reader.finish();
    reader.validate(value);
  }
  template <class Struct>
  void list(const char* key, std::vector<Struct>& value) {
    if (!take(key)) return;
    const YAML::Node node = map_[key];
    if (!node.IsSequence()) fail(key, "must be a list");
    value.clear();
    for (std::size_t i = 0; i < node.size(); ++i) {
      Struct element;
      FieldReader reader(node[i], child_path(key) + "[" + std::to_string(i) + "]");
      element.fields(reader);
      reader.finish();
      reader.validate(element);
      value.push_back(std::move(element));
    }
  }

  // Throws for the first key that is not a field, with the nearest field's name.
  void finish() const;
  // Calls value.check() where the struct has one; it throws std::invalid_argument.
  template <class Struct>
  void validate(const Struct& value) const {
    if constexpr (requires { value.check(); }) {
      try {
        value.check();
      } catch (const std::invalid_argument& problem) {
        fail("", problem.what());
      }
    }
  }
  [[noreturn]] void fail(const std::string& key, const std::string& problem) const;

 private:
  bool take(const char* key);
  void read_word(const char* key, std::string& word) const;
  double number(const YAML::Node& node, const char* key, Constraint constraint) const;
  std::string child_path(const char* key) const;

  YAML::Node map_;
  std::string path_;
  std::vector<std::string> known_;
};

// Writes a struct as YAML: the same `fields` function, the other way round.
class FieldWriter {
 public:
  explicit FieldWriter(YAML::Emitter& out) : out_(out) {}

  void operator()(const char* key, const bool& value);
  void operator()(const char* key, const int& value, Constraint constraint = any());
  void operator()(const char* key, const std::uint64_t& value);
  void operator()(const char* key, const double& value, Constraint constraint = any());
  void operator()(const char* key, const std::string& value);
  void operator()(const char* key, const std::vector<double>& value, Constraint = any());
  void operator()(const char* key, const std::vector<int>& value, Constraint = any());
  void operator()(const char* key, const std::vector<std::string>& value);
  void operator()(const char* key, const Eigen::Vector3d& value, Constraint = any());
  void operator()(const char* key, const Eigen::MatrixXd& value, Constraint = any());
  template <class Enum>
  void operator()(const char* key, const Enum& value, const std::vector<Choice<Enum>>& choices) {
    for (const auto& choice : choices) {
      if (choice.value == value) (*this)(key, std::string(choice.word));
    }
  }
  template <class Struct>
  void section(const char* key, Struct& value) {
    out_ << YAML::Key << key << YAML::Value << YAML::BeginMap;
    value.fields(*this);
    out_ << YAML::EndMap;
  }
  template <class Struct>
  void list(const char* key, std::vector<Struct>& value) {
    if (value.empty()) return;
    out_ << YAML::Key << key << YAML::Value << YAML::BeginSeq;
    for (Struct& element : value) {
      out_ << YAML::BeginMap;
      element.fields(*this);
      out_ << YAML::EndMap;
    }
    out_ << YAML::EndSeq;
  }

 private:
  YAML::Emitter& out_;
};

// A YAML document and the file it came from, for messages.
struct YamlSource {
  YAML::Node root;
  std::string name;
};

// Throws ConfigurationError for what cannot be read or is not YAML (with line and column).
YamlSource load_yaml_file(const std::string& path);
YamlSource parse_yaml(const std::string& text, const std::string& name);
// Applies "a.b.c=value" (the value is YAML).
void apply_setting(YAML::Node& root, const std::string& setting);

// Reads `value` from several documents, later ones overriding earlier ones, then from settings.
// Messages name the file of the document that the offending value came from.
template <class Struct>
void read_configuration(Struct& value, const std::vector<YamlSource>& sources,
                        const std::vector<std::string>& settings) {
  const auto read = [&value](const YAML::Node& root, const std::string& name) {
    try {
      FieldReader reader(root, "");
      value.fields(reader);
      reader.finish();
    } catch (const ConfigurationError& error) {
      throw ConfigurationError(name + ":" + error.what());
    }
  };
  for (const YamlSource& source : sources) read(source.root, source.name);
  if (!settings.empty()) {
    // All at once: one setting may be possible only together with another.
    YAML::Node root(YAML::NodeType::Map);
    for (const std::string& setting : settings) apply_setting(root, setting);
    read(root, "--set");
  }
  // Whole-structure checks see the joined result, not its parts.
  if constexpr (requires { value.check(); }) {
    try {
      value.check();
    } catch (const std::invalid_argument& problem) {
      throw ConfigurationError(
          (sources.empty() ? std::string("configuration") : sources.back().name) + ": " +
          problem.what());
    }
  }
}

template <class Struct>
std::string write_configuration(const Struct& value) {
  YAML::Emitter out;
  out << YAML::BeginMap;
  FieldWriter writer(out);
  const_cast<Struct&>(value).fields(writer);  // `fields` serves reading too, hence not const
  out << YAML::EndMap;
  return std::string(out.c_str()) + "\n";
}

}  // namespace gastronaut

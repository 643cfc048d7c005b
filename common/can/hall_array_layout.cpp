#include "can/hall_array_layout.hpp"

#include <cmath>
#include <filesystem>
#include <set>
#include <string_view>

namespace gastronaut {
namespace {

constexpr std::string_view kSensor = "{sensor}";
constexpr std::string_view kAxis = "{axis}";
constexpr std::string_view kCoil = "{coil}";

std::string put(std::string pattern, std::string_view what, const std::string& value) {
  const std::size_t at = pattern.find(what);
  if (at != std::string::npos) pattern.replace(at, what.size(), value);
  return pattern;
}

std::string axis_name(int axis, int num_axes) {
  return num_axes == 1 ? "z" : std::string(1, static_cast<char>('x' + axis));
}

// SI per `unit`; nothing when it is not a unit of `base` (T or A).
std::optional<double> scale_of(const std::string& unit, const std::string& base) {
  static const std::map<std::string, double> kPrefixes = {{"", 1},     {"m", 1e-3},    {"u", 1e-6},
                                                          {"µ", 1e-6}, {"\xb5", 1e-6}, {"n", 1e-9}};
  if (!unit.ends_with(base)) return std::nullopt;
  const auto prefix = kPrefixes.find(unit.substr(0, unit.size() - base.size()));
  return prefix == kPrefixes.end() ? std::nullopt : std::optional(prefix->second);
}

}  // namespace

HallArrayLayout::HallArrayLayout(std::vector<DbcMessage> messages, const std::string& name,
                                 const CanHallArrayConfiguration& configuration, int num_sensors,
                                 int num_axes)
    : name_(name),
      messages_(std::move(messages)),
      num_sensors_(num_sensors),
      num_axes_(num_axes),
      counters_(messages_.size()) {
  Found found;
  for (std::size_t message = 0; message < messages_.size(); ++message) {
    for (const DbcSignal& signal : messages_[message].signals) {
      if (signal.name == configuration.counter_signal) {
        counters_[message] = signal;
        continue;
      }
      const auto [at, is_new] = found.try_emplace(signal.name, message, &signal);
      if (!is_new) at->second.second = nullptr;  // a matter only if it is one of the reading's
    }
  }
  const int first = configuration.first_number;
  const auto scale = [&](const std::string& signal, const char* base) {
    const auto at = found.find(signal);
    if (at == found.end() || at->second.second == nullptr) return 1.0;  // add_value says so
    const auto factor = scale_of(at->second.second->unit, base);
    if (!factor) {
      fail(at->second.second->line, signal + ": the unit '" + at->second.second->unit +
                                        "' is none of " + base + ", m" + base + ", u" + base +
                                        ", n" + base);
    }
    return *factor;
  };
  for (int sensor = 0; sensor < num_sensors; ++sensor) {
    const std::string pattern =
        put(configuration.field_signal, kSensor, std::to_string(first + sensor));
    for (int axis = 0; axis < num_axes; ++axis) {
      const std::string signal = put(pattern, kAxis, axis_name(axis, num_axes));
      add_value(found, signal, CanStream::kField,
                static_cast<std::size_t>(sensor * num_axes + axis), scale(signal, "T"));
    }
  }
  const auto status_of = [&](int sensor) {
    return put(configuration.status_signal, kSensor, std::to_string(first + sensor));
  };
  has_status_ = !configuration.status_signal.empty() && found.contains(status_of(0));
  for (int sensor = 0; has_status_ && sensor < num_sensors; ++sensor) {
    add_value(found, status_of(sensor), CanStream::kField, status_place(sensor), 1);
  }
  if (!configuration.current_signal.empty()) {
    while (true) {
      const std::string signal =
          put(configuration.current_signal, kCoil, std::to_string(first + num_coils_));
      if (!found.contains(signal)) break;
      add_value(found, signal, CanStream::kCurrents, static_cast<std::size_t>(num_coils_++),
                scale(signal, "A"));
    }
  }
  for (std::size_t part = 0; part < parts_.size(); ++part) {
    const DbcMessage& message = messages_[parts_[part].message];
    check_overlaps(parts_[part]);
    std::vector<std::size_t>& siblings = parts_of_[{message.id, message.extended}];
    siblings.push_back(part);
    const Part& sibling = parts_[siblings.front()];
    if (sibling.multiplex.has_value() != parts_[part].multiplex.has_value()) {
      fail(message.line, message.name +
                             " carries values that are multiplexed and values that are not; each "
                             "needs messages of its own");
    }
    if (sibling.stream != parts_[part].stream) {
      fail(message.line,
           message.name + " carries fields and currents; each needs messages of its own");
    }
  }
}

void HallArrayLayout::add_value(const Found& found, const std::string& signal, CanStream stream,
                                std::size_t place, double scale) {
  const auto at = found.find(signal);
  if (at == found.end()) {
    throw ConfigurationError(name_ + ": there is no signal " + signal + " for the rig's " +
                             std::to_string(num_sensors_) + " sensors of " +
                             std::to_string(num_axes_) +
                             " axes; see can_hall_array in the rig's configuration");
  }
  if (at->second.second == nullptr) {
    throw ConfigurationError(name_ + ": more than one message has a signal " + signal);
  }
  const auto& [message, description] = at->second;
  const std::optional<DbcSignal>& counter = counters_[message];
  if (!counter) {
    fail(messages_[message].line, messages_[message].name + " carries " + signal +
                                      " but no cycle counter; see can_hall_array.counter_signal");
  }
  int& bits = counter_bits_[index(stream)];
  if (counter->type != DbcValueType::kUnsigned || counter->multiplex || counter->num_bits < 4 ||
      counter->num_bits > 32 || (bits != 0 && bits != counter->num_bits)) {
    fail(counter->line, counter->name +
                            ": a cycle counter is unsigned, not multiplexed, has 4 to 32 bits, "
                            "and as many in every message");
  }
  bits = counter->num_bits;
  for (Part& part : parts_) {
    if (part.message == message && part.multiplex == description->multiplex &&
        part.stream == stream) {
      part.values.push_back({place, *description, scale});
      return;
    }
  }
  parts_.push_back(
      {stream, num_parts(stream), message, description->multiplex, {{place, *description, scale}}});
}

void HallArrayLayout::check_overlaps(const Part& part) const {
  std::map<int, const DbcSignal*> owners;
  const auto claim = [&](const DbcSignal& signal) {
    for (const int place : signal.bit_places()) {
      const auto [owner, is_new] = owners.try_emplace(place, &signal);
      if (!is_new) {
        fail(signal.line, signal.name + " and " + owner->second->name + " share bit " +
                              std::to_string(place) + " of " + messages_[part.message].name);
      }
    }
  };
  claim(*counters_[part.message]);
  if (part.multiplex) claim(*messages_[part.message].multiplexor());
  for (const Value& value : part.values) claim(value.signal);
}

void HallArrayLayout::fail(int line, const std::string& problem) const {
  throw ConfigurationError(name_ + ":" + std::to_string(line) + ": " + problem);
}

std::size_t HallArrayLayout::num_values(CanStream stream) const {
  if (stream == CanStream::kCurrents) return static_cast<std::size_t>(num_coils_);
  return static_cast<std::size_t>(num_sensors_ * (num_axes_ + (has_status_ ? 1 : 0)));
}

int HallArrayLayout::num_parts(CanStream stream) const {
  int parts = 0;
  for (const Part& part : parts_) parts += part.stream == stream ? 1 : 0;
  return parts;
}

std::vector<std::pair<std::uint32_t, bool>> HallArrayLayout::identifiers() const {
  std::vector<std::pair<std::uint32_t, bool>> identifiers;
  for (const auto& entry : parts_of_) identifiers.push_back(entry.first);
  return identifiers;
}

HallArrayLayout::Outcome HallArrayLayout::decode(const CanFrame& frame,
                                                 Contribution& contribution) const {
  if (frame.error) return Outcome::kForeign;
  const auto parts = parts_of_.find({frame.id, frame.extended});
  if (parts == parts_of_.end()) return Outcome::kForeign;
  const DbcMessage& message = messages_[parts_[parts->second.front()].message];
  if (frame.remote || frame.length < message.length) return Outcome::kMalformed;
  const DbcSignal* multiplexor = message.multiplexor();
  for (const std::size_t number : parts->second) {
    const Part& part = parts_[number];
    if (part.multiplex && multiplexor->counts(frame.bytes()) != *part.multiplex) continue;
    contribution.stream = part.stream;
    contribution.part = part.number;
    contribution.counter = counters_[part.message]->counts(frame.bytes());
    contribution.values.clear();
    for (const Value& value : part.values) {
      const double decoded = value.scale * value.signal.value(frame.bytes());
      if (!std::isfinite(decoded)) return Outcome::kMalformed;
      contribution.values.emplace_back(value.place, decoded);
    }
    return Outcome::kDecoded;
  }
  return Outcome::kForeign;
}

std::vector<CanFrame> HallArrayLayout::encode(CanStream stream, std::uint64_t counter,
                                              std::span<const double> values) const {
  std::vector<CanFrame> frames;
  for (const Part& part : parts_) {
    if (part.stream != stream) continue;
    const DbcMessage& message = messages_[part.message];
    CanFrame frame;
    frame.id = message.id;
    frame.extended = message.extended;
    frame.length = can_frame_length(static_cast<std::size_t>(message.length));
    frame.fd = frame.length > kClassicCanBytes;
    frame.bit_rate_switch = frame.fd;
    counters_[part.message]->set_counts(frame.data, counter);
    if (part.multiplex) message.multiplexor()->set_counts(frame.data, *part.multiplex);
    for (const Value& value : part.values) {
      value.signal.set_value(frame.data, values[value.place] / value.scale);
    }
    frames.push_back(frame);
  }
  return frames;
}

HallArrayLayout load_hall_array_layout(const RigConfiguration& rig,
                                       const std::vector<std::string>& beside) {
  namespace fs = std::filesystem;
  const fs::path configured = rig.can_hall_array.dbc;
  fs::path path = configured;
  for (const std::string& file : beside) {
    const fs::path candidate = fs::path(file).parent_path() / configured;
    if (configured.is_absolute() || !fs::is_regular_file(candidate)) continue;
    path = candidate;
    break;
  }
  return {load_dbc(path.string()), path.string(), rig.can_hall_array, rig.hall_array.num_sensors(),
          rig.hall_array.num_axes};
}

}  // namespace gastronaut

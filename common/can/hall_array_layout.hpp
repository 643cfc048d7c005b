// Which signals of a CAN database make up a reading of the Hall array and of the coils: the one
// place that turns frames into fields and currents, and (for the virtual rig) back.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "can/can_frame.hpp"
#include "can/dbc.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

// What is measured in one go and numbered by one cycle counter.
enum class CanStream : std::size_t { kField = 0, kCurrents = 1 };
inline constexpr std::size_t kNumCanStreams = 2;

// A value that has not come.
inline constexpr double kNotArrived = std::numeric_limits<double>::quiet_NaN();

class HallArrayLayout {
 public:
  // What one frame carries of a reading.
  struct Contribution {
    CanStream stream = CanStream::kField;
    int part = 0;  // which of the stream's parts
    std::uint64_t counter = 0;
    std::vector<std::pair<std::size_t, double>> values;  // place in the reading, value
  };
  enum class Outcome {
    kDecoded,
    kForeign,    // no frame of this layout
    kMalformed,  // one of ours, but too short, remote, or without a number in it
  };

  // Throws ConfigurationError, naming file, message and signal, when the database does not have
  // every axis of every sensor, or a message without the counter. `name` is the database's, for
  // messages to the user.
  HallArrayLayout(std::vector<DbcMessage> messages, const std::string& name,
                  const CanHallArrayConfiguration& configuration, int num_sensors, int num_axes);

  int num_sensors() const { return num_sensors_; }
  int num_axes() const { return num_axes_; }
  int num_coils() const { return num_coils_; }
  bool has_status() const { return has_status_; }
  // A reading of kField: tesla, sensor by sensor, its axes in order, then (if has_status) the
  // status of each sensor; of kCurrents: ampere, coil by coil.
  std::size_t num_values(CanStream stream) const;
  std::size_t status_place(int sensor) const {
    return static_cast<std::size_t>(num_sensors_ * num_axes_ + sensor);
  }
  // Frames (more exactly: frames and, where they are multiplexed, their cases) a reading has.
  int num_parts(CanStream stream) const;
  int counter_bits(CanStream stream) const { return counter_bits_[index(stream)]; }
  // (identifier, extended) of the frames that are wanted.
  std::vector<std::pair<std::uint32_t, bool>> identifiers() const;

  // `contribution` is filled when the frame was decoded; its memory is used again.
  Outcome decode(const CanFrame& frame, Contribution& contribution) const;
  // The frames of one reading, in the order of the database; utime is left 0. `values` has
  // num_values(stream) finite numbers; each goes out as the nearest that its signal can carry.
  std::vector<CanFrame> encode(CanStream stream, std::uint64_t counter,
                               std::span<const double> values) const;

 private:
  static std::size_t index(CanStream stream) { return static_cast<std::size_t>(stream); }

  struct Value {
    std::size_t place;  // in the reading
    DbcSignal signal;
    double scale;  // SI per unit of the signal
  };
  struct Part {
    CanStream stream = CanStream::kField;
    int number = 0;
    std::size_t message = 0;
    std::optional<std::uint64_t> multiplex;
    std::vector<Value> values;
  };
  using Found = std::map<std::string, std::pair<std::size_t, const DbcSignal*>>;

  void add_value(const Found& found, const std::string& signal, CanStream stream, std::size_t place,
                 double scale);
  void check_overlaps(const Part& part) const;
  [[noreturn]] void fail(int line, const std::string& problem) const;

  std::string name_;
  std::vector<DbcMessage> messages_;
  int num_sensors_;
  int num_axes_;
  int num_coils_ = 0;
  bool has_status_ = false;
  std::array<int, kNumCanStreams> counter_bits_{};
  std::vector<Part> parts_;
  std::vector<std::optional<DbcSignal>> counters_;                               // of each message
  std::map<std::pair<std::uint32_t, bool>, std::vector<std::size_t>> parts_of_;  // by identifier
};

// The configured database bound to the rig's array. A relative path of the database is looked for
// beside each of `beside` (files, usually those of --config) in turn, then in the working folder.
HallArrayLayout load_hall_array_layout(const RigConfiguration& rig,
                                       const std::vector<std::string>& beside);

}  // namespace gastronaut

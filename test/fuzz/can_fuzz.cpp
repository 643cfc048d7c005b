// Any text as a CAN database and, after a zero byte, as a log of candump: signals that lie in their
// messages and carry their counts, frames that are written as they were read, readings by ascending
// number; or an error in words.
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>
#include <string_view>

#include "can/candump.hpp"
#include "can/hall_array_layout.hpp"
#include "can_hall_array/cycle_assembler.hpp"
#include "configuration/fields.hpp"
#include "fuzz_check.hpp"

using namespace gastronaut;

namespace {

void check_signal(const DbcMessage& message, const DbcSignal& signal) {
  for (const int place : signal.bit_places()) {
    promise(place >= 0 && place < 8 * message.length, "a signal lies within its message");
  }
  std::array<std::uint8_t, kMostCanBytes> data{};
  const std::uint64_t most = ~std::uint64_t{0} >> (64 - signal.num_bits);
  for (const std::uint64_t counts : {most, most / 3, std::uint64_t{0}}) {
    signal.set_counts(data, counts);
    promise(signal.counts(data) == counts, "a signal carries its counts");
    const double value = signal.value(data);
    if (std::isfinite(value)) signal.set_value(data, value);
  }
}

// Two sensors of three axes and whatever coils there are, by the default names.
void check_readings(const std::vector<DbcMessage>& messages, const std::vector<CanFrame>& frames) {
  std::optional<HallArrayLayout> bound;
  try {
    bound.emplace(messages, "fuzz.dbc", CanHallArrayConfiguration{}, 2, 3);
  } catch (const ConfigurationError&) {
    return;
  }
  const HallArrayLayout& layout = *bound;
  const std::size_t num_values = layout.num_values(CanStream::kField);
  CycleAssembler::Settings settings;
  settings.num_parts = layout.num_parts(CanStream::kField);
  settings.num_values = num_values;
  settings.counter_bits = layout.counter_bits(CanStream::kField);
  std::optional<std::int64_t> last;
  CycleAssembler assembler(settings, [&](const CycleAssembler::Reading& reading) {
    promise(reading.values.size() == num_values, "a reading has a place for every value");
    promise(!last || reading.number > *last, "readings come by ascending number");
    last = reading.number;
  });
  HallArrayLayout::Contribution contribution;
  for (const CanFrame& frame : frames) {
    if (layout.decode(frame, contribution) != HallArrayLayout::Outcome::kDecoded) continue;
    if (contribution.stream != CanStream::kField) continue;
    assembler.add(contribution.part, contribution.counter, frame.utime, contribution.values);
  }
  assembler.finish();
  for (const CanFrame& frame :
       layout.encode(CanStream::kField, 1, std::vector<double>(num_values, 1.0))) {
    promise(layout.decode(frame, contribution) != HallArrayLayout::Outcome::kForeign,
            "what is encoded is recognised");
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(bytes), size);
  const std::size_t zero = std::min(text.find('\0'), size);
  std::vector<CanFrame> frames;
  std::string_view log = text.substr(std::min(zero + 1, size));
  while (!log.empty()) {
    const std::size_t end = std::min(log.find('\n'), log.size());
    try {
      const CandumpLine line = parse_candump_line(log.substr(0, end));
      promise(line.frame.length <= kMostCanBytes, "a frame has at most 64 bytes");
      const CandumpLine again = parse_candump_line(format_candump_line(line));
      promise(again.frame == line.frame && again.interface == line.interface,
              "a frame is written as it was read");
      frames.push_back(line.frame);
    } catch (const std::invalid_argument&) {
    }
    log.remove_prefix(std::min(end + 1, log.size()));
  }
  std::vector<DbcMessage> messages;
  try {
    messages = parse_dbc(text.substr(0, zero), "fuzz.dbc");
  } catch (const ConfigurationError& error) {
    promise(std::string_view(error.what()).starts_with("fuzz.dbc:"), "an error names its line");
    return 0;
  }
  for (const DbcMessage& message : messages) {
    for (const DbcSignal& signal : message.signals) check_signal(message, signal);
  }
  check_readings(messages, frames);
  return 0;
}

#include "can_hall_array/can_hall_array_process.hpp"

#include <cmath>
#include <cstdlib>
#include <gastronaut/coil_currents_t.hpp>
#include <gastronaut/hall_array_t.hpp>

#include "process/channels.hpp"
#include "process/rig_config_message.hpp"

namespace gastronaut {
namespace {

constexpr std::int64_t kConfigurationPeriod = 10'000'000;  // microseconds between RIG_CONFIG

}  // namespace

CanHallArrayProcess::CanHallArrayProcess(Bus& bus, const RigConfiguration& rig,
                                         HallArrayLayout layout)
    : bus_(bus),
      rig_(rig),
      layout_(std::move(layout)),
      assemblers_{make_assembler(CanStream::kField), make_assembler(CanStream::kCurrents)} {}

CycleAssembler CanHallArrayProcess::make_assembler(CanStream stream) {
  CycleAssembler::Settings settings;
  settings.num_parts = layout_.num_parts(stream);
  settings.num_values = layout_.num_values(stream);
  settings.counter_bits = layout_.counter_bits(stream);
  settings.rate = rig_.hall_array.rate;
  settings.timeout = rig_.can_hall_array.timeout;
  return {settings, [this, stream](const CycleAssembler::Reading& reading) {
            stream == CanStream::kField ? publish_field(reading) : publish_currents(reading);
          }};
}

void CanHallArrayProcess::handle(const CanFrame& frame) {
  if (frame.error) return monitor_.handle(frame);
  switch (layout_.decode(frame, contribution_)) {
    case HallArrayLayout::Outcome::kForeign:
      return;
    case HallArrayLayout::Outcome::kMalformed:
      ++frames_;
      ++malformed_;
      return;
    case HallArrayLayout::Outcome::kDecoded:
      break;
  }
  ++frames_;
  monitor_.heard();
  publish_configuration(frame.utime);
  assembler(contribution_.stream)
      .add(contribution_.part, contribution_.counter, frame.utime, contribution_.values);
}

void CanHallArrayProcess::advance(std::int64_t utime) {
  publish_configuration(utime);
  for (CycleAssembler& stream : assemblers_) stream.advance(utime);
}

void CanHallArrayProcess::finish() {
  for (CycleAssembler& stream : assemblers_) stream.finish();
}

const CycleAssembler::Counters& CanHallArrayProcess::counters(CanStream stream) const {
  return assemblers_[static_cast<std::size_t>(stream)].counters();
}

void CanHallArrayProcess::publish_configuration(std::int64_t utime) {
  const bool clock_was_set_back = utime < configuration_due_ - kConfigurationPeriod;
  if (utime < configuration_due_ && !clock_was_set_back) return;
  bus_.publish(channel::kRigConfig, rig_config_message(rig_, utime));
  configuration_due_ = utime + kConfigurationPeriod;
}

void CanHallArrayProcess::publish_field(const CycleAssembler::Reading& reading) {
  const int num_axes = layout_.num_axes();
  hall_array_t message;
  message.utime = reading.utime;
  message.seq = static_cast<std::int32_t>(reading.number);
  message.num_sensors = layout_.num_sensors();
  message.num_axes = num_axes;
  message.field.resize(static_cast<std::size_t>(message.num_sensors));
  message.status.assign(static_cast<std::size_t>(message.num_sensors), hall_array_t::STATUS_OK);
  for (int sensor = 0; sensor < message.num_sensors; ++sensor) {
    const auto index = static_cast<std::size_t>(sensor);
    std::int32_t& status = message.status[index];
    if (layout_.has_status()) {
      constexpr std::int32_t kKnown = std::int32_t{hall_array_t::STATUS_SATURATED} |
                                      std::int32_t{hall_array_t::STATUS_STALE} |
                                      std::int32_t{hall_array_t::STATUS_FAULT};
      const double told = reading.values[layout_.status_place(sensor)];
      status = std::isnan(told) ? std::int32_t{hall_array_t::STATUS_STALE}
                                : static_cast<std::int32_t>(std::lround(told)) & kKnown;
    }
    for (int axis = 0; axis < num_axes; ++axis) {
      const double field = reading.values[static_cast<std::size_t>(sensor * num_axes + axis)];
      if (std::isnan(field)) status |= hall_array_t::STATUS_STALE;
      if (std::abs(field) >= rig_.hall_array.saturation) status |= hall_array_t::STATUS_SATURATED;
      message.field[index].push_back(static_cast<float>(field));
    }
  }
  bus_.publish(channel::kHallArray, message);
}

void CanHallArrayProcess::publish_currents(const CycleAssembler::Reading& reading) {
  if (!reading.complete) return;
  coil_currents_t message;
  message.utime = reading.utime;
  message.seq = static_cast<std::int32_t>(reading.number);
  message.num_coils = layout_.num_coils();
  message.current.assign(reading.values.begin(), reading.values.end());
  bus_.publish(channel::kCoilCurrents, message);
}

CanHallArrayProcess::Told CanHallArrayProcess::now(std::int64_t dropped) const {
  Told told;
  for (const CycleAssembler& stream : assemblers_) {
    told.incomplete += stream.counters().incomplete;
    told.lost += stream.counters().lost;
    told.restarts += stream.counters().restarts;
  }
  told.frames = frames_;
  told.dropped = dropped;
  told.malformed = malformed_;
  told.overflows = monitor_.counters().overflows;
  told.errors = monitor_.counters().error_frames;
  return told;
}

CanHallArrayProcess::Health CanHallArrayProcess::report(std::int64_t dropped) {
  const std::string& interface = rig_.can_hall_array.interface;
  const Told before = told_;
  told_ = now(dropped);
  std::string text = monitor_.describe(interface);
  const auto add = [&text](const std::string& more) { text += (text.empty() ? "" : "; ") + more; };
  const auto count = [&](std::int64_t Told::*what, const std::string& words) {
    if (told_.*what > before.*what) add(std::to_string(told_.*what - before.*what) + words);
  };
  if (told_.frames == before.frames) {
    add("nothing comes from the Hall array on " + interface +
        "; check its power, the wiring and the bit rate: ip -details -statistics link show " +
        interface);
  }
  count(&Told::incomplete, " readings with frames missing");
  count(&Told::lost, " readings did not come at all");
  count(&Told::dropped, " frames lost because this program was too slow");
  count(&Told::overflows, " times the adapter lost frames: it overflowed");
  count(&Told::malformed, " frames too short for the CAN database; is it this array's?");
  count(&Told::restarts, " times the array began to count anew");
  count(&Told::errors, " error frames on the bus");
  return {text.empty() ? ProcessState::kRunning : ProcessState::kDegraded, text};
}

}  // namespace gastronaut

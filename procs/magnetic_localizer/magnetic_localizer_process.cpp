#include "magnetic_localizer/magnetic_localizer_process.hpp"

#include <algorithm>

#include "gastronaut/magnetic_pose_t.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

magnetic_pose_t to_message(const magnetics::MagneticFix& fix, const hall_array_t& reading) {
  magnetic_pose_t message;
  message.utime = reading.utime;
  message.seq = reading.seq;
  message.status = static_cast<std::int8_t>(fix.status);
  for (int i = 0; i < 3; ++i) {
    message.position[i] = fix.state.position[i];
    message.axis[i] = fix.state.axis[i];
    message.background[i] = fix.state.background[i];
  }
  message.moment = fix.state.moment;
  for (int i = 0; i < 5; ++i) {
    for (int j = 0; j < 5; ++j) message.covariance[i][j] = fix.covariance(i, j);
  }
  message.residual_rms = fix.residual_rms;
  message.chi2_per_dof = fix.chi2_per_dof;
  message.num_channels_used = fix.num_channels_used;
  return message;
}

}  // namespace

MagneticLocalizerProcess::MagneticLocalizerProcess(Bus& bus, const RigConfiguration& configuration)
    : bus_(bus),
      num_coils_(configuration.coils.tesla_per_ampere.cols()),
      num_sensors_(configuration.hall_array.num_sensors()),
      num_axes_(configuration.hall_array.num_axes),
      max_current_gap_(
          static_cast<std::int64_t>(configuration.magnetic_localizer.max_current_gap * 1e6)),
      currents_(configuration.magnetic_localizer.max_current_gap),
      localizer_(configuration) {
  reading_.field.resize(static_cast<Eigen::Index>(num_sensors_) * num_axes_);
  reading_.status.resize(num_sensors_);
  if (num_coils_ > 0) {
    // Before the readings: at equal utime the currents are to be known first.
    bus.subscribe<coil_currents_t>(
        channel::kCoilCurrents, configuration.lag.coil_currents,
        [this](const coil_currents_t& currents) { handle_currents(currents); });
  }
  bus.subscribe<hall_array_t>(channel::kHallArray, configuration.lag.hall_array,
                              [this](const hall_array_t& reading) { handle_reading(reading); });
}

void MagneticLocalizerProcess::handle_currents(const coil_currents_t& currents) {
  const Eigen::VectorXd ampere =
      Eigen::Map<const Eigen::VectorXf>(currents.current.data(), currents.num_coils).cast<double>();
  if (currents.num_coils != num_coils_) {
    report_problem("COIL_CURRENTS has " + std::to_string(currents.num_coils) +
                   " coils, the configuration " + std::to_string(num_coils_) +
                   ": load the configuration of this rig");
  } else if (!ampere.allFinite()) {
    report_problem("COIL_CURRENTS holds currents that are not numbers: check the coil driver");
  } else {
    currents_.add(currents.utime, ampere);
  }
  localize_ready_readings();
}

void MagneticLocalizerProcess::handle_reading(const hall_array_t& reading) {
  waiting_.push_back(reading);
  localize_ready_readings();
}

void MagneticLocalizerProcess::localize_ready_readings() {
  while (!waiting_.empty()) {
    const std::int64_t utime = waiting_.front().utime;
    const bool currents_known = num_coils_ == 0 || currents_.newest().value_or(utime - 1) >= utime;
    const bool waited_enough = bus_.event_utime() - utime > max_current_gap_;
    if (!currents_known && !waited_enough) return;
    localize(waiting_.front());
    waiting_.pop_front();
  }
}

void MagneticLocalizerProcess::finish() {
  for (const hall_array_t& reading : waiting_) localize(reading);
  waiting_.clear();
}

void MagneticLocalizerProcess::localize(const hall_array_t& reading) {
  if (reading.num_sensors != num_sensors_ || reading.num_axes != num_axes_) {
    report_problem("HALL_ARRAY has " + std::to_string(reading.num_sensors) + " sensors of " +
                   std::to_string(reading.num_axes) + " axes, the configuration " +
                   std::to_string(num_sensors_) + " of " + std::to_string(num_axes_) +
                   ": load the configuration of this rig");
    bus_.publish(channel::kMagneticPose, to_message(localizer_.no_reading(), reading));
    return;
  }
  for (int s = 0; s < num_sensors_; ++s) {
    const auto sensor = static_cast<std::size_t>(s);
    reading_.status[s] = reading.status[sensor];
    for (int axis = 0; axis < num_axes_; ++axis) {
      reading_.field[s * num_axes_ + axis] = reading.field[sensor][static_cast<std::size_t>(axis)];
    }
  }
  const magnetics::MagneticFix fix = localizer_.localize(reading_, currents_.at(reading.utime));
  report_problem(fix.status == magnetics::FixStatus::kNoCurrents
                     ? "no COIL_CURRENTS around the readings: check the coil driver"
                     : "");
  bus_.publish(channel::kMagneticPose, to_message(fix, reading));
}

void MagneticLocalizerProcess::report_problem(const std::string& problem) {
  if (problem == problem_) return;
  problem_ = problem;
  bus_.set_health(problem.empty() ? ProcessState::kRunning : ProcessState::kDegraded, problem);
}

ProcessDescription magnetic_localizer_process() {
  return {"magnetic_localizer",
          "Localises the capsule's magnet from the Hall array, the coils' field removed.",
          channel::kHallArray,
          [](const RigConfiguration&) { return std::vector<std::string>{channel::kMagneticPose}; },
          [](Bus& bus, const RigConfiguration& configuration) {
            return std::make_unique<MagneticLocalizerProcess>(bus, configuration);
          },
          {}};
}

}  // namespace gastronaut

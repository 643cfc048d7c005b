// Channels of the magnetic localiser: HALL_ARRAY and COIL_CURRENTS in, one MAGNETIC_POSE out for
// every Hall reading, whatever happens to it.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>

#include "bus/bus.hpp"
#include "configuration/rig_configuration.hpp"
#include "gastronaut/coil_currents_t.hpp"
#include "gastronaut/hall_array_t.hpp"
#include "magnetic_localizer/magnetic_localizer.hpp"
#include "magnetics/coil_field.hpp"
#include "process/process.hpp"

namespace gastronaut {

// A reading waits until the currents around it are known: until a coil sample at or after its utime
// has been handled, or event time is more than max_current_gap beyond it, or the end.
class MagneticLocalizerProcess : public Process {
 public:
  // Throws ConfigurationError where the estimator cannot work with the array.
  MagneticLocalizerProcess(Bus& bus, const RigConfiguration& configuration);

  void finish() override;

 private:
  void handle_currents(const coil_currents_t& currents);
  void handle_reading(const hall_array_t& reading);
  void localize_ready_readings();
  void localize(const hall_array_t& reading);
  void report_problem(const std::string& problem);

  Bus& bus_;
  Eigen::Index num_coils_;
  int num_sensors_;
  int num_axes_;
  std::int64_t max_current_gap_;  // microseconds
  CurrentHistory currents_;
  magnetics::MagneticLocalizer localizer_;
  magnetics::HallReading reading_;
  std::deque<hall_array_t> waiting_;
  std::string problem_;  // of the last reading
};

ProcessDescription magnetic_localizer_process();

}  // namespace gastronaut

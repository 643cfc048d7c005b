// The virtual rig on the bus: turns its simulated readings and pictures into messages, straight
// into a log or live over LCM.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "virtual_rig/scenario.hpp"

namespace gastronaut {

// Everything that the rig says, in the order of utime.
class VirtualRigProcess {
 public:
  using Sink = std::function<void(const std::string& channel, std::vector<std::uint8_t> payload,
                                  std::int64_t utime)>;

  // `start_utime` is the scenario's time zero, microseconds. Throws ConfigurationError when the
  // scenario cannot be played.
  VirtualRigProcess(const VirtualRigScenario& scenario, std::int64_t start_utime, Sink sink);
  ~VirtualRigProcess();

  // Time of the next event, seconds from the start.
  double next_time() const;
  // Handles it.
  void step();
  // Pictures made and skipped so far.
  std::int64_t pictures() const;
  std::int64_t pictures_skipped() const;
  // Pictures for whose time (seconds from the start) `skip` says so are left out: for live running
  // on a machine that cannot keep up.
  void skip_pictures(std::function<bool(double)> skip);

  void write_surface(const std::string& path) const;
  // The rig with its true sensor errors, coil matrix and moment, as YAML.
  void write_truth(const std::string& path) const;

 private:
  struct Rig;
  std::unique_ptr<Rig> rig_;
};

}  // namespace gastronaut

#include "virtual_rig/scenario.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>

namespace gastronaut {
namespace {

constexpr double kFaultFlank = 0.3;  // seconds

double smooth_step(double x) {
  const double t = std::clamp(x, 0.0, 1.0);
  return t * t * (3 - 2 * t);
}

std::string beside(const std::string& scenario_file, const std::string& path) {
  return (std::filesystem::path(scenario_file).parent_path() / path).lexically_normal().string();
}

}  // namespace

void TrajectoryConfiguration::check() const {
  if (returns && swings != std::floor(swings)) {
    throw std::invalid_argument("swings must be a whole number for a tour that returns");
  }
  if (nearest > furthest) throw std::invalid_argument("nearest must not be beyond furthest");
}

void CoilGeometryConfiguration::check() const {
  if (inner_radius >= outer_radius) {
    throw std::invalid_argument("a coil's inner_radius must be smaller than its outer_radius");
  }
}

void FaultConfiguration::check() const {
  if (!(end > start)) throw std::invalid_argument("a fault's end must lie after its start");
  const bool on_sensors = kind == FaultKind::kSaturatedSensor || kind == FaultKind::kStuckSensor ||
                          kind == FaultKind::kStaleSensor;
  if (on_sensors && sensors.empty()) {
    throw std::invalid_argument("a sensor fault needs 'sensors', the list of those that fail");
  }
  if (kind == FaultKind::kForeignField && moment.isZero()) {
    throw std::invalid_argument("a foreign field needs 'position' and 'moment' of its source");
  }
  if (kind == FaultKind::kLostMessages && (channel.empty() || strength == 0 || strength > 1)) {
    throw std::invalid_argument(
        "lost messages need 'channel' and 'strength', the fraction that is lost (0..1)");
  }
  const bool graded = kind == FaultKind::kTurbid || kind == FaultKind::kBlur ||
                      kind == FaultKind::kOcclusion || kind == FaultKind::kMagnetFar;
  if (graded && strength == 0) throw std::invalid_argument("this fault needs a 'strength'");
}

double FaultConfiguration::envelope(double time) const {
  return smooth_step((time - start) / kFaultFlank) * smooth_step((end - time) / kFaultFlank);
}

void VirtualRigScenario::check() const {
  rig.check();
  const Eigen::Index coils = magnetics.coils.rows * magnetics.coils.cols;
  if (rig.coils.tesla_per_ampere.size() != 0) {
    throw std::invalid_argument(
        "rig.coils.tesla_per_ampere must not be given: the virtual rig computes it from "
        "magnetics.coils (" +
        std::to_string(coils) + " coils)");
  }
  for (const FaultConfiguration& fault : faults) {
    for (const int sensor : fault.sensors) {
      if (sensor >= rig.hall_array.num_sensors()) {
        throw std::invalid_argument("faults: there is no Hall sensor " + std::to_string(sensor) +
                                    "; they are numbered from 0 to " +
                                    std::to_string(rig.hall_array.num_sensors() - 1));
      }
    }
  }
}

VirtualRigScenario load_scenario(const std::string& file,
                                 const std::vector<std::string>& settings) {
  const YamlSource source = load_yaml_file(file);
  VirtualRigScenario names;  // read once for the files that the scenario starts from
  read_configuration(names, {source}, settings);
  VirtualRigScenario scenario;
  std::vector<std::string> rig_files;
  for (const std::string& path : {names.rig_file, names.camera_file}) {
    if (!path.empty()) rig_files.push_back(beside(file, path));
  }
  scenario.rig = load_rig_configuration(rig_files, {});
  read_configuration(scenario, {source}, settings);
  if (!scenario.organ.mesh.empty()) scenario.organ.mesh = beside(file, scenario.organ.mesh);
  return scenario;
}

}  // namespace gastronaut

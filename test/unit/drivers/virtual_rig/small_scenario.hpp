// A scenario that is built and rendered in a moment.
#pragma once

#include "virtual_rig/scenario.hpp"

namespace gastronaut {

inline VirtualRigScenario small_scenario() {
  VirtualRigScenario scenario;
  scenario.duration = 1;
  scenario.organ.edge = 0.003;
  scenario.rig.camera.width = 64;
  scenario.rig.camera.height = 48;
  scenario.rig.camera.fx = scenario.rig.camera.fy = 33;
  scenario.rig.camera.cx = 31.5;
  scenario.rig.camera.cy = 23.5;
  return scenario;
}

}  // namespace gastronaut

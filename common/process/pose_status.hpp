// Which statuses of the pose channels mean that a pose is to be used.
#pragma once

#include <array>

namespace gastronaut {

struct PoseStatus {
  const char* name;
  bool usable;  // the message counts as a fix
};
// Indexed by the message's status.
inline constexpr std::array<PoseStatus, 6> kMagneticPoseStatuses = {{{"OK", true},
                                                                     {"NO_FIX", false},
                                                                     {"TOO_FAR", false},
                                                                     {"INTERFERENCE", false},
                                                                     {"SATURATED", false},
                                                                     {"NO_CURRENTS", false}}};
inline constexpr std::array<PoseStatus, 4> kVisualPoseStatuses = {
    {{"OK", true}, {"DEGRADED", true}, {"LOST", false}, {"RELOCALISED", true}}};
inline constexpr std::array<PoseStatus, 4> kCapsuleStateStatuses = {
    {{"INITIALISING", false}, {"NOMINAL", true}, {"DEGRADED", true}, {"PREDICTING", false}}};

}  // namespace gastronaut

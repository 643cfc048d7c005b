// A capsule whose magnet sits where we say, seen by a camera and by a Hall array that err as we
// say.
#pragma once

#include <cstdint>
#include <functional>
#include <numbers>
#include <vector>

#include "calibrate/hand_eye_model.hpp"

namespace gastronaut {

inline constexpr double kOneDegree = std::numbers::pi / 180;

// One sigma an axis, independent from pose to pose; what reference-facts.md 6 measured with.
struct HandEyeErrors {
  double camera_position = 2e-4;  // metres
  double camera_rotation = 0.2 * kOneDegree;
  double magnet_position = 3e-4;
  double magnet_axis = 0.5 * kOneDegree;
};

struct SimulatedHandEye {
  std::vector<VisualFrame> frames;
  std::vector<MagneticFix> fixes;
};

// What the simulations take for true, but for the time offset: none.
HandEye true_hand_eye();
// 2 cm and some 150 degrees off.
HandEye wrong_hand_eye();

// Camera poses in the map, `count` of them: anywhere in a box of 6 cm, turned by up to 60 degrees
// about any axis.
std::vector<SE3> random_poses(int count, std::uint64_t seed);

// The camera stands still at each pose in turn for a tenth of a second, one fix each.
SimulatedHandEye stop_and_go(const HandEye& truth, const std::vector<SE3>& poses,
                             const HandEyeErrors& errors, std::uint64_t seed);

// Errors that depend on the place (of the fix, metres and radians) or on the time.
struct SharedErrors {
  double magnetic_position = 0;  // metres, rms an axis, waves some 15 cm long
  double magnetic_axis = 0;      // radians
  double visual_position = 0;    // metres, rms an axis, a walk that forgets within 4 s
  double visual_rotation = 0;    // radians
};

// It swings smoothly about all axes for `duration` seconds: 20 frames and 100 fixes a second. Only
// the fixes have independent errors.
SimulatedHandEye swinging(const HandEye& truth, double duration, const HandEyeErrors& errors,
                          const SharedErrors& shared, std::uint64_t seed);

// Estimate less truth: the centre in metres, the axis in radians about perpendicular_basis of the
// estimated one.
Vector5d hand_eye_error(const HandEye& estimate, const HandEye& truth);

}  // namespace gastronaut

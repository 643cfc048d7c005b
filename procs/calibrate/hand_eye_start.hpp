// Where a hand-eye calibration begins when nothing is known: axis and map rotation from the fixes'
// axes alone, then centre, scale and map translation, which are linear.
#pragma once

#include <vector>

#include "calibrate/hand_eye_model.hpp"

namespace gastronaut {

// One start for each of 41 directions that the axis may have, `configured` and 40 all over the
// sphere, the best first. A fix in each pose's middle is looked at.
std::vector<HandEye> find_starts(const VisualTrack& track, const std::vector<HandEyePose>& poses,
                                 const HandEye& configured);

}  // namespace gastronaut

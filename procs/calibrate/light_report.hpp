// What `calibrate light` hands back: a fragment of the rig configuration and a table for the eye.
#pragma once

#include <string>

#include "calibrate/light_calibration.hpp"

namespace gastronaut {

std::string light_table(const LightCalibration& calibration, const RigConfiguration& before,
                        const LightCalibrationOptions& options);
// `log`: the name that the fragment gives as its source.
std::string light_fragment(const LightCalibration& calibration, const RigConfiguration& before,
                           const LightCalibrationOptions& options, const std::string& log);

}  // namespace gastronaut

// What a calibration hands back: a fragment of the rig configuration, to be given as a further
// --config file, with its uncertainties beside the values; and a table for the eye.
#pragma once

#include <optional>
#include <string>

#include "calibrate/array_calibration.hpp"
#include "calibrate/coil_calibration.hpp"

namespace gastronaut {

// Each line behind "# ".
std::string commented(const std::string& text);

// `log`: the name that the fragment gives as its source. Without `rig` the fragment of a coil
// calibration has the matrix alone; the offsets have no place to go and stand in comments.
std::string coil_fragment(const CoilCalibration& calibration,
                          const std::optional<RigConfiguration>& rig, const std::string& log);
std::string coil_table(const CoilCalibration& calibration);

std::string array_fragment(const ArrayCalibration& calibration, const RigConfiguration& before,
                           const std::string& log);
std::string array_table(const ArrayCalibration& calibration, const RigConfiguration& before);

}  // namespace gastronaut

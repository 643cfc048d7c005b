// From a derived log to a report folder.
#pragma once

#include <string>
#include <vector>

#include "evaluate/metrics.hpp"
#include "evaluate/sensor_failures.hpp"

namespace gastronaut::evaluation {

// Writes all of the report but the plots into the existing `folder` and returns the figures, with
// what could not be evaluated as note.1, note.2 and so on. `frames`: numbers of the pictures to
// show; none: a few. `surface`: a PLY file that the map is compared with, or empty. `failures`:
// when sensors failed in truth. Throws std::runtime_error.
Metrics evaluate_log(const std::string& log, const std::string& folder,
                     const std::vector<std::size_t>& frames = {}, const std::string& surface = "",
                     const std::vector<TrueFailure>& failures = {});

}  // namespace gastronaut::evaluation

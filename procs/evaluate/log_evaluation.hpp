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
// when sensors failed in truth. `surface_pairs`: a CSV file of picked points that places the map on
// the surface, or empty. Throws std::runtime_error, and std::invalid_argument for pairs that do not
// place it.
Metrics evaluate_log(const std::string& log, const std::string& folder,
                     const std::vector<std::size_t>& frames = {}, const std::string& surface = "",
                     const std::vector<TrueFailure>& failures = {},
                     const std::string& surface_pairs = "");

}  // namespace gastronaut::evaluation

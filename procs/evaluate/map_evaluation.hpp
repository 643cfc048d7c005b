// What became of the map: its errors against the true surface, files for other programs, and
// pictures.
#pragma once

#include <optional>
#include <span>
#include <string>

#include "evaluate/evaluate_process.hpp"
#include "evaluate/metrics.hpp"
#include "evaluate/picture_evaluation.hpp"

namespace gastronaut::evaluation {

// Sets map.*, deformation.*, surface.thickness.* (of the stable surfels), where the log has
// GROUND_TRUTH_DEPTH surface.seen.PLACEMENT.* (of up to 50 000 of them, against what the true
// camera saw when each was last measured, where the map says it is and placed by the trajectory)
// and, where `surface` names a file, surface.*; the map is placed by the pairs of points in the
// file `pairs` (surface_placement.hpp), where one is named, else by the trajectory, and in a log
// that has neither truth nor fused poses by its shape; writes into FOLDER map.ply (all surfels, map
// frame), map_error.ply (all, where they are compared, coloured by their error), map_size.csv,
// deformations.csv, surface_histogram.csv, and into FOLDER/map the pictures for report.py. Nothing
// for a run without a map. What could not be used is added to the run's notes. Throws
// std::runtime_error for a surface or pairs that cannot be used or files that cannot be written.
void evaluate_map(Metrics& metrics, const std::string& log, const std::string& folder,
                  const std::string& surface, const std::string& pairs,
                  std::span<const ShownFrame> frames, RecordedRun& run);

}  // namespace gastronaut::evaluation

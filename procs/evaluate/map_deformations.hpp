// What MAP_DEFORMATION says of the map's bends: how many of each kind, what they mended, and how
// far they moved the map.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "evaluate/metrics.hpp"

namespace gastronaut::evaluation {

enum class DeformationKind { kFrame, kLocalLoop, kGlobalLoop };

// Of the deformation graph of one bend.
struct MapDeformation {
  std::int64_t utime = 0;
  std::int32_t map_version = 0;
  DeformationKind kind = DeformationKind::kFrame;
  std::int32_t nodes = 0;
  std::int32_t constraints = 0;
  double error_before = 0;  // metres, mean over the constraints
  double error_after = 0;
  double largest_move = 0;  // metres, of a node
};

// For KIND in frame, local_loop and global_loop deformation.KIND.count, and where there were any
// .error_before and .error_after (metres, median over them) and .largest_move (metres, of all).
// Nothing for no deformations.
void set_deformation_metrics(Metrics& metrics, std::span<const MapDeformation> deformations);

// One row a deformation. Throws std::runtime_error when the file cannot be written.
void write_deformations(const std::string& path, std::span<const MapDeformation> deformations);

}  // namespace gastronaut::evaluation

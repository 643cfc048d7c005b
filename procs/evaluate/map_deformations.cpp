#include "evaluate/map_deformations.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <limits>
#include <stdexcept>
#include <vector>

#include "evaluate/trajectory_errors.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr std::array<const char*, 3> kNames = {"frame", "local_loop", "global_loop"};

}  // namespace

void set_deformation_metrics(Metrics& metrics, std::span<const MapDeformation> deformations) {
  if (deformations.empty()) return;
  for (std::size_t kind = 0; kind < kNames.size(); ++kind) {
    std::size_t count = 0;
    std::vector<double> before;
    std::vector<double> after;
    double largest = 0;
    for (const MapDeformation& deformation : deformations) {
      if (deformation.kind != static_cast<DeformationKind>(kind)) continue;
      ++count;
      if (std::isfinite(deformation.error_before)) before.push_back(deformation.error_before);
      if (std::isfinite(deformation.error_after)) after.push_back(deformation.error_after);
      largest = std::max(largest, deformation.largest_move);
    }
    const std::string key = std::string("deformation.") + kNames[kind];
    metrics.set_count(key + ".count", count);
    if (count == 0) continue;
    if (!before.empty()) metrics.set(key + ".error_before", quantile(before, 0.5));
    if (!after.empty()) metrics.set(key + ".error_after", quantile(after, 0.5));
    metrics.set(key + ".largest_move", largest);
  }
}

void write_deformations(const std::string& path, std::span<const MapDeformation> deformations) {
  std::ofstream file(path);
  file.precision(std::numeric_limits<float>::max_digits10);
  file << "utime,map_version,nodes,constraints,error_before,error_after,largest_move,kind\n";
  for (const MapDeformation& deformation : deformations) {
    file << deformation.utime << "," << deformation.map_version << "," << deformation.nodes << ","
         << deformation.constraints << "," << deformation.error_before << ","
         << deformation.error_after << "," << deformation.largest_move << ","
         << kNames[static_cast<std::size_t>(deformation.kind)] << "\n";
  }
  if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

}  // namespace gastronaut::evaluation

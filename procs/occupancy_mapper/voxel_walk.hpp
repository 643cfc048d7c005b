// The voxels that a line passes, one after the other (Amanatides and Woo, "A fast voxel traversal
// algorithm for ray tracing", Eurographics 1987).
#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>

namespace gastronaut::occupancy {

// visit(voxel) for each voxel from that of `from` to that of `to`, both included; voxel (i, j, k)
// is the cube from (i, j, k) to (i + 1, j + 1, k + 1). Each step is to a neighbour over a face, and
// there are never more than needed, whatever the rounding.
template <class Visit>
void walk_voxels(const Eigen::Vector3d& from, const Eigen::Vector3d& to, const Visit& visit) {
  constexpr double kNever = std::numeric_limits<double>::infinity();
  Eigen::Vector3i voxel;
  Eigen::Vector3i step;
  Eigen::Vector3i left;       // steps along each axis
  Eigen::Vector3d next;       // where the line crosses to the next voxel along each axis, 0..1
  Eigen::Vector3d increment;  // from one crossing to the one after it
  for (int axis = 0; axis < 3; ++axis) {
    const double begin = std::floor(from[axis]);
    const double direction = to[axis] - from[axis];
    voxel[axis] = static_cast<int>(begin);
    left[axis] = std::abs(static_cast<int>(std::floor(to[axis])) - voxel[axis]);
    step[axis] = direction < 0 ? -1 : 1;
    const double border = direction < 0 ? begin : begin + 1;
    next[axis] = left[axis] > 0 ? (border - from[axis]) / direction : kNever;
    increment[axis] = left[axis] > 0 ? std::abs(1 / direction) : 0;
  }
  visit(voxel);
  for (int remaining = left.sum(); remaining > 0; --remaining) {
    int axis = next[1] < next[0] ? 1 : 0;
    if (next[2] < next[axis]) axis = 2;
    voxel[axis] += step[axis];
    next[axis] = --left[axis] > 0 ? next[axis] + increment[axis] : kNever;
    visit(voxel);
  }
}

}  // namespace gastronaut::occupancy

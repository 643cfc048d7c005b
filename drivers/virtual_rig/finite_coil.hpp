// Field of circular coils with a winding of finite length and thickness, as a grid of circular
// current loops; each loop by complete elliptic integrals (Smythe, Static and Dynamic Electricity,
// 7.10), exact everywhere but on the wire.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "virtual_rig/scenario.hpp"

namespace gastronaut {

// Field in tesla per ampere at `offset` = field point minus the loop's centre (metres); the loop of
// the given radius lies in the plane of x and y, its current turns about +z.
Eigen::Vector3d current_loop_field(const Eigen::Vector3d& offset, double radius);

// Field in tesla per ampere in each coil, columns as coils are numbered, at a point of the rig
// frame.
Eigen::Matrix3Xd coil_fields(const CoilGeometryConfiguration& coils, const Eigen::Vector3d& point);

}  // namespace gastronaut

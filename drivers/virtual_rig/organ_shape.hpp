// Smooth shapes of organs before folds and bumps: the procedural stomach and meshes from files.
#pragma once

#include "virtual_rig/organ.hpp"

namespace gastronaut {

struct OrganShape {
  TriangleMesh mesh;  // normals set
  Centreline centreline;
};

// A tube of elliptic cross-section about a bent axis, closed at both ends, centred on the origin.
OrganShape procedural_stomach(const OrganConfiguration& organ);

// A flat rectangle in the plane z = 0, centred on the origin, facing up; its axis lies in it.
OrganShape flat_card(const OrganConfiguration& organ);

// A closed mesh in millimetres, subdivided to organ.edge, turned so that its longest direction is
// the rig's x and its middle one y, and centred on the origin. Throws ConfigurationError when the
// file cannot be read or is something else.
OrganShape organ_from_file(const OrganConfiguration& organ);

}  // namespace gastronaut

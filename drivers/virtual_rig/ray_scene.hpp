// A triangle mesh that rays are traced against, sixteen at a time (Embree).
#pragma once

#include <embree3/rtcore.h>

#include "virtual_rig/organ.hpp"

namespace gastronaut {

class RayScene {
 public:
  // Throws std::runtime_error when Embree cannot start.
  // A mesh that moves is traced a little slower.
  RayScene(const TriangleMesh& mesh, bool moves);
  ~RayScene();
  RayScene(const RayScene&) = delete;
  RayScene& operator=(const RayScene&) = delete;

  // Of a mesh that moves: the triangles are as they were.
  void move_vertices(const std::vector<Eigen::Vector3f>& vertices);

  static constexpr int kWidth = 16;
  // valid[i]: -1 trace ray i, 0 leave it alone. Safe from several threads.
  void intersect(const int* valid, RTCRayHit16& rays) const;
  // Rays that hit something have tfar < 0 afterwards.
  void occluded(const int* valid, RTCRay16& rays) const;

 private:
  void fill_vertices(const std::vector<Eigen::Vector3f>& vertices);

  RTCDevice device_ = nullptr;
  RTCScene scene_ = nullptr;
  RTCGeometry geometry_ = nullptr;
  void* buffer_ = nullptr;
};

}  // namespace gastronaut

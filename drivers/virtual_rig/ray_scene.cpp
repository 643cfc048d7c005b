#include "virtual_rig/ray_scene.hpp"

#include <algorithm>
#include <cstring>
#include <stdexcept>

namespace gastronaut {

RayScene::RayScene(const TriangleMesh& mesh, bool moves) {
  // One thread builds the tree: which of two equally near triangles a ray hits must not depend on
  // how many cores there are.
  device_ = rtcNewDevice("threads=1");
  if (device_ == nullptr) throw std::runtime_error("Embree cannot be started on this machine");
  scene_ = rtcNewScene(device_);
  rtcSetSceneFlags(scene_,
                   moves ? RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_DYNAMIC : RTC_SCENE_FLAG_ROBUST);
  geometry_ = rtcNewGeometry(device_, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetGeometryBuildQuality(geometry_, moves ? RTC_BUILD_QUALITY_REFIT : RTC_BUILD_QUALITY_HIGH);
  buffer_ = rtcSetNewGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                    sizeof(Eigen::Vector3f), mesh.vertices.size());
  void* triangles = rtcSetNewGeometryBuffer(geometry_, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                            sizeof(Triangle), mesh.triangles.size());
  if (buffer_ == nullptr || triangles == nullptr) throw std::bad_alloc();
  std::memcpy(triangles, mesh.triangles.data(), mesh.triangles.size() * sizeof(Triangle));
  fill_vertices(mesh.vertices);
  rtcCommitGeometry(geometry_);
  rtcAttachGeometry(scene_, geometry_);
  rtcCommitScene(scene_);
}

RayScene::~RayScene() {
  rtcReleaseGeometry(geometry_);
  rtcReleaseScene(scene_);
  rtcReleaseDevice(device_);
}

void RayScene::fill_vertices(const std::vector<Eigen::Vector3f>& vertices) {
  auto* coordinates = static_cast<float*>(buffer_);
  for (const Eigen::Vector3f& vertex : vertices) {
    coordinates = std::copy(vertex.begin(), vertex.end(), coordinates);
  }
}

void RayScene::move_vertices(const std::vector<Eigen::Vector3f>& vertices) {
  fill_vertices(vertices);
  rtcUpdateGeometryBuffer(geometry_, RTC_BUFFER_TYPE_VERTEX, 0);
  rtcCommitGeometry(geometry_);
  rtcCommitScene(scene_);
}

void RayScene::intersect(const int* valid, RTCRayHit16& rays) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  rtcIntersect16(valid, scene_, &context, &rays);
}

void RayScene::occluded(const int* valid, RTCRay16& rays) const {
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  rtcOccluded16(valid, scene_, &context, &rays);
}

}  // namespace gastronaut

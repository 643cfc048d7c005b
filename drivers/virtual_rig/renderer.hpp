// Pictures of the wall as the lens sees them, in linear light, and its true depth.
//
// Linear light of a pixel = gain cos^vignetting_cos_power(ray) * sum over the lights of
// led_intensity cos^lobe(angle from the optical axis) / r^2 * (albedo cos(normal, light) +
// highlight), nothing where the wall shadows the light.
#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "configuration/rig_configuration.hpp"
#include "geometry/se3.hpp"
#include "virtual_rig/organ.hpp"
#include "virtual_rig/ray_scene.hpp"
#include "virtual_rig/tissue.hpp"

namespace gastronaut {

// Murky fluid between lens and wall: light is lost on its way there and back, and the fluid glows.
struct Fluid {
  float extinction = 0;                            // per metre
  Eigen::Vector3f glow = Eigen::Vector3f::Zero();  // linear light of endless fluid at gain 1
};

class Renderer {
 public:
  // `rest` is the wall that `tissue` is painted on; both must outlive the renderer.
  Renderer(const CameraConfiguration& camera, const LightsConfiguration& lights,
           const TriangleMesh& rest, const Tissue& tissue, bool wall_moves);

  // The wall has moved (only with wall_moves).
  void move_wall(const TriangleMesh& wall);

  // Three floats a pixel (red, green, blue; full scale is 1), the mean over rig_T_cameras: the
  // poses that the camera has while the shutter is open.
  std::vector<float> render(const std::vector<SE3>& rig_T_cameras, double gain,
                            const Fluid& fluid) const;

  // Metres along the optical axis on the undistorted pinhole grid of the same size, focal lengths
  // and principal point; 0 where there is no wall.
  std::vector<float> depth(const SE3& rig_T_camera) const;

  // The longest way in pixels that anything 30 mm off moves between two poses.
  double motion_in_pixels(const SE3& from, const SE3& to) const;

 private:
  struct Shot;
  struct Block;
  template <class Body>
  void for_blocks(const Body& body) const;
  void render_block(const Shot& shot, const Block& block, std::vector<float>& picture) const;

  CameraConfiguration camera_;
  CameraModel lens_;
  double lobe_;
  std::vector<Eigen::Vector3f> lights_;  // camera frame, metres
  const TriangleMesh& rest_;
  const Tissue& tissue_;
  TriangleMesh wall_;  // vertices are Embree's copy; here the normals count
  RayScene scene_;
  std::vector<Eigen::Vector3f> rays_;  // unit, camera frame; zero: the lens sees nothing there
  std::vector<float> vignetting_;
  std::vector<float> lobe_table_;  // cos^lobe over the cosine
};

}  // namespace gastronaut

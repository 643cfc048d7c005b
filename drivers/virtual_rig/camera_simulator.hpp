// The visual half of the virtual rig: exposure, motion blur, optical faults, sensor noise, gamma
// and JPEG around the renderer's linear light.
#pragma once

#include <cstdint>
#include <vector>

#include "virtual_rig/organ.hpp"
#include "virtual_rig/renderer.hpp"
#include "virtual_rig/scenario.hpp"
#include "virtual_rig/tissue.hpp"
#include "virtual_rig/trajectory.hpp"

namespace gastronaut {

struct CameraFrame {
  double gain = 1;  // metadata "gain"
  std::vector<std::uint8_t> jpeg;
  std::vector<std::uint16_t> depth;  // counts of metres_per_depth_count, row by row; 0: no wall
};

class CameraSimulator {
 public:
  // Organ and trajectory must outlive it.
  CameraSimulator(const VirtualRigScenario& scenario, const Organ& organ,
                  const Trajectory& trajectory);
  ~CameraSimulator();
  CameraSimulator(const CameraSimulator&) = delete;
  CameraSimulator& operator=(const CameraSimulator&) = delete;

  // Frame number `index`, mid-exposure at `time`. Auto-exposure looks at the frame before, so calls
  // must come in order.
  CameraFrame take(std::int64_t index, double time);

 private:
  std::vector<SE3> poses_while_open(double time) const;
  Fluid fluid_at(double time) const;
  void blur(std::vector<float>& picture, double sigma) const;
  void occlude(std::vector<float>& picture, double time, double fraction) const;
  std::vector<std::uint8_t> develop(const std::vector<float>& picture, std::int64_t index) const;
  void adjust_gain(const std::vector<std::uint8_t>& picture);
  std::vector<std::uint8_t> compress(const std::vector<std::uint8_t>& picture) const;

  VirtualRigScenario scenario_;
  const Organ& organ_;
  const Trajectory& trajectory_;
  Tissue tissue_;
  Renderer renderer_;
  TriangleMesh wall_;
  double gain_ = 1;
  void* jpeg_ = nullptr;
};

}  // namespace gastronaut

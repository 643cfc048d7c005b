// What the pose channels say: one pose a message.
#pragma once

#include <gastronaut/capsule_state_t.hpp>
#include <gastronaut/magnetic_pose_t.hpp>
#include <gastronaut/pose_t.hpp>
#include <gastronaut/rigid_transform_t.hpp>
#include <gastronaut/visual_pose_t.hpp>

#include "geometry/se3.hpp"
#include "process/pose_status.hpp"

namespace gastronaut {

// rig_T_magnet (the rotation about the magnet's axis is arbitrary), map_T_camera, and rig_T_camera.
// The translation is NaN where the message holds no pose: no number, or a zero quaternion or axis.
SE3 pose_of(const magnetic_pose_t& message);
SE3 pose_of(const visual_pose_t& message);
SE3 pose_of(const capsule_state_t& message);
SE3 pose_of(const pose_t& message);
SE3 pose_of(const rigid_transform_t& message);

}  // namespace gastronaut

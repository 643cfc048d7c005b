// Cameras that the kernel has (Video for Linux, /dev/videoN).
#pragma once

#include <memory>
#include <string>

#include "configuration/rig_configuration.hpp"
#include "uvc_camera/camera.hpp"

namespace gastronaut {

// The given device, else the first one that captures and fits vendor, product and serial;
// streaming. Throws CameraUnavailable with what to do, ConfigurationError where the camera has not
// what is asked.
std::unique_ptr<Camera> open_v4l2_camera(const RigConfiguration& rig);

// Whether there is one that open_v4l2_camera would take.
bool has_v4l2_camera(const UvcCameraConfiguration& wanted);

// For people: cameras, formats, sizes, rates and controls.
std::string list_v4l2_cameras();

}  // namespace gastronaut

// Cameras through libusb: found, opened, and streamed from on the calling thread.
#pragma once

#include <memory>
#include <string>

#include "configuration/rig_configuration.hpp"
#include "uvc_camera/usb_transport.hpp"
#include "uvc_camera/uvc_descriptors.hpp"

namespace gastronaut {

struct OpenedUsbCamera {
  std::unique_ptr<UsbTransport> transport;
  UvcFunction function;
  std::string name;  // "Logi C270 (046d:0825, serial E190CC90)"
};

// The first camera that fits vendor, product and serial; a kernel driver that has it is detached
// until the transport is destroyed. `reset`: as if it had been unplugged and plugged in. Throws
// CameraUnavailable with what to do.
OpenedUsbCamera open_usb_camera(const UvcCameraConfiguration& wanted, bool reset);

// For people: cameras, formats, sizes, rates and controls.
std::string list_usb_cameras();

}  // namespace gastronaut

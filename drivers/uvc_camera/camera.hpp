// What the driver asks of a camera, whichever way its pictures come.
#pragma once

#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "uvc_camera/camera_controls.hpp"
#include "uvc_camera/picture.hpp"

namespace gastronaut {

// The camera is not there, or no more. Another one may be opened later.
class CameraUnavailable : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

struct CameraCounters {
  std::int64_t pictures = 0;  // whole ones
  std::int64_t damaged = 0;   // cut short, not decodable, or marked so by camera or bus
  std::int64_t lost = 0;  // missing from the kernel's count: damaged there, or not taken in time

  CameraCounters& operator+=(const CameraCounters& other) {
    pictures += other.pictures;
    damaged += other.damaged;
    lost += other.lost;
    return *this;
  }
};

class Camera {
 public:
  virtual ~Camera() = default;
  // The next whole picture; none within `seconds`: nothing. Throws CameraUnavailable.
  virtual std::optional<Picture> next(double seconds) = 0;
  virtual CameraCounters counters() const = 0;
  virtual const LockedControls& controls() const = 0;
  // "Logi C270 (046d:0825, serial 1234) by libusb, MJPEG 640x480 at 30 Hz"
  virtual std::string describe() const = 0;
};

}  // namespace gastronaut

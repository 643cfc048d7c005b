// A USB Video Class camera over a USB transport: negotiates, locks the controls, streams.
#pragma once

#include <deque>
#include <functional>
#include <memory>
#include <string>

#include "configuration/rig_configuration.hpp"
#include "uvc_camera/camera.hpp"
#include "uvc_camera/usb_transport.hpp"
#include "uvc_camera/uvc_descriptors.hpp"
#include "uvc_camera/uvc_frame_assembler.hpp"

namespace gastronaut {

// The controls of a UVC function by class requests (UVC 1.5, 4.2).
class UsbCameraControls : public CameraControls {
 public:
  UsbCameraControls(UsbTransport& transport, const UvcFunction& function)
      : transport_(transport), function_(function) {}
  std::optional<int> get(CameraControl control) override;
  std::optional<ControlRange> range(CameraControl control) override;
  bool set(CameraControl control, int value) override;

 private:
  UsbTransport& transport_;
  const UvcFunction& function_;
};

// What probe and commit agreed on (UVC 1.5, 4.3.1.1).
struct UvcStreamSettings {
  const UvcStream* stream = nullptr;
  const UvcFormat* format = nullptr;
  const UvcFrameSize* size = nullptr;
  std::uint32_t interval = 0;         // ticks
  std::uint32_t largest_frame = 0;    // bytes
  std::uint32_t largest_payload = 0;  // bytes
};

// Of what the camera offers the wanted size and, with "auto", MJPEG before YUYV. Throws
// ConfigurationError that lists what there is, where it does not fit.
UvcStreamSettings choose_stream(const UvcFunction& function, const RigConfiguration& rig);

class UsbCamera : public Camera {
 public:
  using Clock = std::function<std::int64_t()>;  // utime now
  // `name` is for messages. Starts streaming. Throws CameraUnavailable, ConfigurationError.
  UsbCamera(std::unique_ptr<UsbTransport> transport, UvcFunction function,
            const RigConfiguration& rig, std::string name, Clock clock);
  ~UsbCamera() override;
  UsbCamera(const UsbCamera&) = delete;
  UsbCamera& operator=(const UsbCamera&) = delete;

  std::optional<Picture> next(double seconds) override;
  CameraCounters counters() const override;
  const LockedControls& controls() const override { return locked_; }
  std::string describe() const override;

 private:
  void negotiate();
  void start();
  void take(UvcFrame frame);

  std::unique_ptr<UsbTransport> transport_;
  UvcFunction function_;
  std::string name_;
  Clock clock_;
  UvcStreamSettings settings_;
  PictureEncoding encoding_ = PictureEncoding::kMjpeg;
  LockedControls locked_;
  std::unique_ptr<UvcFrameAssembler> assembler_;
  std::deque<Picture> pictures_;
  std::int64_t undecodable_ = 0;
  std::int64_t whole_ = 0;
};

}  // namespace gastronaut

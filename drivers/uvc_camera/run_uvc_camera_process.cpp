#include "uvc_camera/run_uvc_camera_process.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <memory>
#include <thread>

#include "bus/host_check.hpp"
#include "bus/lcm_bus.hpp"
#include "bus/wall_clock.hpp"
#include "process/command_line.hpp"
#include "process/status_reporter.hpp"
#include "uvc_camera/libusb_transport.hpp"
#include "uvc_camera/usb_camera.hpp"
#include "uvc_camera/uvc_camera_process.hpp"
#include "uvc_camera/v4l2_camera.hpp"

namespace gastronaut {
namespace {

struct Options {
  std::vector<std::string> configuration_files;
  std::vector<std::string> settings;
  std::string lcm_url;
  bool list = false;
};

std::unique_ptr<Camera> open_camera(const RigConfiguration& rig, bool reset) {
  const UvcCameraConfiguration& wanted = rig.uvc_camera;
  const bool by_kernel =
      wanted.back_end == "v4l2" ||
      (wanted.back_end == "auto" && (!wanted.device.empty() || has_v4l2_camera(wanted)));
  if (by_kernel) return open_v4l2_camera(rig);
  OpenedUsbCamera opened = open_usb_camera(wanted, reset);
  return std::make_unique<UsbCamera>(std::move(opened.transport), std::move(opened.function), rig,
                                     std::move(opened.name), wall_utime);
}

// A camera that is unplugged, hangs, and comes back.
class CameraWatch {
 public:
  explicit CameraWatch(const RigConfiguration& rig) : rig_(rig) {}

  // A picture; nothing, when none came within a tenth of a second.
  std::optional<Picture> next() {
    try {
      if (!camera_) {
        camera_ = open_camera(rig_, is_reset_due_);
        is_reset_due_ = false;
        controls_ = camera_->controls();
        spdlog::info("{}", camera_->describe());
        problem_.clear();
        last_ = Clock::now() + kStart;
      }
      constexpr double kMostWait = 0.1;  // seconds, so that signals and status are not forgotten
      std::optional<Picture> picture = camera_->next(kMostWait);
      const auto now = Clock::now();
      if (picture) {
        last_ = now;
      } else if (now - last_ > silence()) {
        is_reset_due_ = true;
        leave(
            fmt::format("no picture for {:.1f} s: starting the camera again", seconds(silence())));
      }
      return picture;
    } catch (const CameraUnavailable& unavailable) {
      leave(unavailable.what());
      constexpr auto kRetry = std::chrono::milliseconds(200);
      std::this_thread::sleep_for(kRetry);
      return std::nullopt;
    }
  }

  CameraCounters counters() const {
    CameraCounters all = before_;
    if (camera_) all += camera_->counters();
    return all;
  }
  const LockedControls& controls() const { return controls_; }
  // Why no picture can come; empty: they can.
  const std::string& problem() const { return problem_; }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr auto kStart =
      std::chrono::seconds(2);  // until the first picture, beyond silence

  static double seconds(Clock::duration duration) {
    return std::chrono::duration<double>(duration).count();
  }
  Clock::duration silence() const {
    constexpr double kLeast = 1;     // second
    constexpr double kPictures = 5;  // periods
    return std::chrono::duration_cast<Clock::duration>(
        std::chrono::duration<double>(std::max(kLeast, kPictures / rig_.camera.rate)));
  }
  void leave(const std::string& why) {
    if (camera_) before_ += camera_->counters();
    camera_.reset();
    problem_ = why;
  }

  RigConfiguration rig_;
  std::unique_ptr<Camera> camera_;
  bool is_reset_due_ = false;
  LockedControls controls_;
  CameraCounters before_;
  std::string problem_;
  Clock::time_point last_ = Clock::now();
};

int run_live(const RigConfiguration& rig, LcmBus& bus) {
  UvcCameraProcess process(bus, rig);
  CameraWatch watch(rig);
  StatusReporter reporter(bus, "uvc_camera");
  std::string said;
  const auto say = [&said](const std::string& message) {
    if (message != said && !message.empty()) spdlog::warn("{}", message);
    said = message;
  };
  while (!stop_requested()) {
    if (const std::optional<Picture> picture = watch.next()) {
      process.handle(*picture, watch.controls());
    } else {
      process.advance(wall_utime());
    }
    if (!watch.problem().empty()) say(watch.problem());
    if (!reporter.due()) continue;
    UvcCameraProcess::Health health = process.report(watch.counters(), watch.controls());
    if (!watch.problem().empty()) health = {ProcessState::kDegraded, watch.problem()};
    say(health.message);
    BusCounters counters = bus.counters();
    counters.received = watch.counters().pictures;
    counters.dropped = watch.counters().lost;
    counters.lost = watch.counters().damaged;
    reporter.tick(counters, health.state, health.message);
  }
  const CameraCounters counted = watch.counters();
  spdlog::info("{} pictures, {} damaged, {} lost", counted.pictures, counted.damaged, counted.lost);
  return kExitDone;
}

int list() {
  const auto print = [](const char* title, const std::string& cameras) {
    std::printf("%s\n%s", title, cameras.empty() ? "none\n" : cameras.c_str());
  };
  print("== through libusb (uvc_camera.back_end: usb)", list_usb_cameras());
  print("== the kernel's (uvc_camera.back_end: v4l2)", list_v4l2_cameras());
  return kExitDone;
}

int run(const Options& options) {
  if (options.list) return list();
  if (options.configuration_files.empty()) {
    throw ConfigurationError("the rig's configuration is needed: --config FILE");
  }
  const RigConfiguration rig =
      load_rig_configuration(options.configuration_files, options.settings);
  const std::string url = resolve_lcm_url(options.lcm_url);
  for (const std::string& problem : check_host(url)) spdlog::warn("{}", problem);
  LcmBus bus(url);
  spdlog::info("running on {}", url);
  return run_live(rig, bus);
}

}  // namespace

int run_uvc_camera(int argc, char** argv) {
  CLI::App app(
      "Publishes a USB camera's pictures, through libusb or the kernel's driver; MJPEG as it "
      "comes. "
      "Exposure, gain and white balance are locked, and told with each picture.\n\n"
      "What is there: uvc_camera --list\n"
      "Live:          uvc_camera --config config/rigs/lab.yaml",
      "uvc_camera");
  Options options;
  add_configuration_options(app, options.configuration_files, options.settings);
  app.add_flag("--list", options.list, "print cameras, formats, sizes, rates and controls");
  app.add_option("--lcm-url", options.lcm_url,
                 std::string("LCM URL; default: $LCM_DEFAULT_URL, else ") + kDefaultLcmUrl);
  return run_command_line(app, argc, argv, [&] { return run(options); });
}

}  // namespace gastronaut

#include "uvc_camera/v4l2_camera.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <set>
#include <utility>

#include "bus/wall_clock.hpp"

namespace gastronaut {
namespace {

constexpr std::int64_t kMicroseconds = 1'000'000;
constexpr unsigned kBuffers = 8;  // pictures that may wait while this program is busy

class FileHandle {
 public:
  explicit FileHandle(const std::string& path)
      : handle_(open(path.c_str(), O_RDWR | O_NONBLOCK | O_CLOEXEC)) {
    if (handle_ >= 0) return;
    const std::string why = std::strerror(errno);
    throw CameraUnavailable(errno == EACCES
                                ? path +
                                      " may not be used by this user; try: sudo usermod -aG video "
                                      "$USER, and log in anew"
                                : path + ": " + why);
  }
  ~FileHandle() { close(handle_); }
  FileHandle(const FileHandle&) = delete;
  FileHandle& operator=(const FileHandle&) = delete;
  int get() const { return handle_; }

  // Result of the request; interrupted calls are made again.
  template <class Argument>
  int request(unsigned long what, Argument* argument) const {
    int result = 0;
    do {
      result = ioctl(handle_, what, argument);
    } while (result < 0 && errno == EINTR);
    return result;
  }

 private:
  int handle_;
};

class V4l2Controls : public CameraControls {
 public:
  explicit V4l2Controls(const FileHandle& file) : file_(file) {}

  std::optional<int> get(CameraControl control) override {
    v4l2_control value{};
    value.id = identifier(control);
    if (file_.request(VIDIOC_G_CTRL, &value) != 0) return std::nullopt;
    if (control == CameraControl::kAutomaticExposure) {
      return value.value == V4L2_EXPOSURE_MANUAL ? 0 : 1;
    }
    return value.value;
  }

  std::optional<ControlRange> range(CameraControl control) override {
    v4l2_queryctrl query{};
    query.id = identifier(control);
    if (file_.request(VIDIOC_QUERYCTRL, &query) != 0) return std::nullopt;
    if (control == CameraControl::kAutomaticExposure) return ControlRange{0, 1, 1, 1};
    return ControlRange{query.minimum, query.maximum, std::max(1, query.step), query.default_value};
  }

  bool set(CameraControl control, int wanted) override {
    v4l2_control value{};
    value.id = identifier(control);
    value.value = wanted;
    if (control == CameraControl::kAutomaticExposure) {
      value.value = wanted == 0 ? V4L2_EXPOSURE_MANUAL : V4L2_EXPOSURE_APERTURE_PRIORITY;
    }
    return file_.request(VIDIOC_S_CTRL, &value) == 0;
  }

 private:
  static std::uint32_t identifier(CameraControl control) {
    switch (control) {
      case CameraControl::kAutomaticExposure:
        return V4L2_CID_EXPOSURE_AUTO;
      case CameraControl::kExposureTime:
        return V4L2_CID_EXPOSURE_ABSOLUTE;
      case CameraControl::kExposurePriority:
        return V4L2_CID_EXPOSURE_AUTO_PRIORITY;
      case CameraControl::kGain:
        return V4L2_CID_GAIN;
      case CameraControl::kAutomaticWhiteBalance:
        return V4L2_CID_AUTO_WHITE_BALANCE;
      case CameraControl::kWhiteBalance:
        return V4L2_CID_WHITE_BALANCE_TEMPERATURE;
      case CameraControl::kBacklightCompensation:
        return V4L2_CID_BACKLIGHT_COMPENSATION;
    }
    return 0;
  }

  const FileHandle& file_;
};

std::string four_characters(std::uint32_t code) {
  std::string text;
  for (int shift = 0; shift < 32; shift += 8) text += static_cast<char>(code >> shift & 0x7f);
  return text;
}

struct Found {
  std::string path;
  std::string name;
};

std::string first_line(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  return line;
}

// Every /dev/videoN that captures pictures, in the order of N.
std::vector<Found> find_cameras(const UvcCameraConfiguration& wanted) {
  namespace fs = std::filesystem;
  std::vector<Found> found;
  std::error_code error;
  std::set<std::pair<std::size_t, std::string>> names;  // by length first: video10 behind video9
  for (const auto& entry : fs::directory_iterator("/sys/class/video4linux", error)) {
    const std::string name = entry.path().filename();
    if (name.starts_with("video")) names.emplace(name.size(), name);
  }
  for (const auto& [length, name] : names) {
    const fs::path system = fs::path("/sys/class/video4linux") / name;
    const fs::path usb = system / "device" / "..";
    const auto fits = [&](const char* file, const std::string& value) {
      return value.empty() || first_line(usb / file) == value;
    };
    const std::string path = "/dev/" + name;
    if (!wanted.device.empty() && wanted.device != path) continue;
    if (!fits("idVendor", wanted.vendor) || !fits("idProduct", wanted.product) ||
        !fits("serial", wanted.serial)) {
      continue;
    }
    // A camera has further nodes, for metadata; the first one is that of the pictures.
    if (first_line(system / "index") != "0") continue;
    found.push_back({path, first_line(system / "name") + " (" + path + ")"});
  }
  return found;
}

class V4l2Camera : public Camera {
 public:
  V4l2Camera(const Found& found, const RigConfiguration& rig)
      : name_(found.name), width_(rig.camera.width), height_(rig.camera.height), file_(found.path) {
    v4l2_capability capability{};
    if (file_.request(VIDIOC_QUERYCAP, &capability) != 0 ||
        (capability.device_caps & V4L2_CAP_VIDEO_CAPTURE) == 0 ||
        (capability.device_caps & V4L2_CAP_STREAMING) == 0) {
      throw CameraUnavailable(name_ + " does not stream pictures");
    }
    choose_format(rig);
    V4l2Controls controls(file_);
    locked_ = lock_controls(controls, rig.uvc_camera);
    start();
  }

  ~V4l2Camera() override {
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    file_.request(VIDIOC_STREAMOFF, &type);
    for (const auto& [start, length] : buffers_) munmap(start, length);
  }
  V4l2Camera(const V4l2Camera&) = delete;
  V4l2Camera& operator=(const V4l2Camera&) = delete;

  std::optional<Picture> next(double seconds) override {
    pollfd polled{file_.get(), POLLIN, 0};
    constexpr double kMilliseconds = 1e3;
    const int ready = poll(&polled, 1, static_cast<int>(std::ceil(seconds * kMilliseconds)));
    if (ready <= 0) return std::nullopt;
    v4l2_buffer buffer{};
    buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    buffer.memory = V4L2_MEMORY_MMAP;
    if (file_.request(VIDIOC_DQBUF, &buffer) != 0) {
      if (errno == EAGAIN) return std::nullopt;
      throw CameraUnavailable(errno == ENODEV ? name_ + " was unplugged"
                                              : name_ + ": " + std::strerror(errno));
    }
    std::optional<Picture> picture = take(buffer);
    if (file_.request(VIDIOC_QBUF, &buffer) != 0) throw CameraUnavailable(name_ + " was unplugged");
    return picture;
  }

  CameraCounters counters() const override { return counters_; }
  const LockedControls& controls() const override { return locked_; }
  std::string describe() const override {
    return fmt::format("{} by the kernel's driver, {} {}x{} at {:.4g} Hz", name_,
                       encoding_ == PictureEncoding::kMjpeg ? "MJPEG" : "YUYV", width_, height_,
                       rate_);
  }

 private:
  void choose_format(const RigConfiguration& rig) {
    const std::string& wanted = rig.uvc_camera.format;
    for (const PictureEncoding encoding : {PictureEncoding::kMjpeg, PictureEncoding::kYuyv}) {
      if (wanted == "mjpeg" && encoding != PictureEncoding::kMjpeg) continue;
      if (wanted == "yuyv" && encoding != PictureEncoding::kYuyv) continue;
      const std::uint32_t code =
          encoding == PictureEncoding::kMjpeg ? V4L2_PIX_FMT_MJPEG : V4L2_PIX_FMT_YUYV;
      v4l2_format format{};
      format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
      format.fmt.pix.width = static_cast<std::uint32_t>(width_);
      format.fmt.pix.height = static_cast<std::uint32_t>(height_);
      format.fmt.pix.pixelformat = code;
      const int result = file_.request(VIDIOC_S_FMT, &format);
      if (result != 0 && errno == EBUSY) {
        throw CameraUnavailable(name_ + " is in use by another program");
      }
      if (result != 0 || format.fmt.pix.pixelformat != code ||
          format.fmt.pix.width != static_cast<std::uint32_t>(width_) ||
          format.fmt.pix.height != static_cast<std::uint32_t>(height_)) {
        continue;
      }
      encoding_ = encoding;
      set_rate(rig.camera.rate);
      return;
    }
    throw ConfigurationError(
        fmt::format("{} offers no {}x{}{}; uvc_camera --list shows what it has; set camera.width, "
                    "camera.height",
                    name_, width_, height_, wanted == "auto" ? "" : " in " + wanted));
  }

  void set_rate(double rate) {
    constexpr std::uint32_t kDenominator = 1000;
    v4l2_streamparm parameters{};
    parameters.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    v4l2_fract& period = parameters.parm.capture.timeperframe;
    period.numerator = kDenominator;
    period.denominator = static_cast<std::uint32_t>(std::lround(rate * kDenominator));
    rate_ = rate;
    if (file_.request(VIDIOC_S_PARM, &parameters) == 0 && period.numerator > 0) {
      rate_ = static_cast<double>(period.denominator) / period.numerator;
    }
  }

  void start() {
    v4l2_requestbuffers request{};
    request.count = kBuffers;
    request.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    request.memory = V4L2_MEMORY_MMAP;
    check(file_.request(VIDIOC_REQBUFS, &request));
    for (std::uint32_t index = 0; index < request.count; ++index) {
      v4l2_buffer buffer{};
      buffer.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
      buffer.memory = V4L2_MEMORY_MMAP;
      buffer.index = index;
      check(file_.request(VIDIOC_QUERYBUF, &buffer));
      void* start = mmap(nullptr, buffer.length, PROT_READ | PROT_WRITE, MAP_SHARED, file_.get(),
                         buffer.m.offset);
      if (start == MAP_FAILED) check(-1);
      buffers_.emplace_back(start, buffer.length);
      check(file_.request(VIDIOC_QBUF, &buffer));
    }
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
    check(file_.request(VIDIOC_STREAMON, &type));
  }

  void check(int result) const {
    if (result != 0) throw CameraUnavailable(name_ + ": " + std::strerror(errno));
  }

  std::optional<Picture> take(const v4l2_buffer& buffer) {
    if (sequence_ && buffer.sequence > *sequence_ + 1) {
      counters_.lost += buffer.sequence - *sequence_ - 1;
    }
    sequence_ = buffer.sequence;
    const auto* bytes = static_cast<const std::uint8_t*>(buffers_[buffer.index].first);
    const std::span data(bytes, buffer.bytesused);
    if ((buffer.flags & V4L2_BUF_FLAG_ERROR) != 0 ||
        !picture_problem(encoding_, width_, height_, data).empty()) {
      ++counters_.damaged;
      return std::nullopt;
    }
    ++counters_.pictures;
    return Picture{encoding_, width_, height_, utime_of(buffer), {data.begin(), data.end()}};
  }

  // The kernel's stamps are of the clock that nobody sets; how far that is from the host's time is
  // looked up for each, so that it follows.
  std::int64_t utime_of(const v4l2_buffer& buffer) const {
    const std::int64_t now = wall_utime();
    if ((buffer.flags & V4L2_BUF_FLAG_TIMESTAMP_MASK) != V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC) {
      return now;
    }
    timespec monotonic{};
    clock_gettime(CLOCK_MONOTONIC, &monotonic);
    const std::int64_t ago = (monotonic.tv_sec - buffer.timestamp.tv_sec) * kMicroseconds +
                             monotonic.tv_nsec / 1000 - buffer.timestamp.tv_usec;
    const bool is_start =
        (buffer.flags & V4L2_BUF_FLAG_TSTAMP_SRC_MASK) == V4L2_BUF_FLAG_TSTAMP_SRC_SOE;
    const double to_middle = is_start ? locked_.exposure.value_or(0) / 2 : 0;
    return now - ago + std::llround(to_middle * static_cast<double>(kMicroseconds));
  }

  std::string name_;
  int width_;
  int height_;
  double rate_ = 0;
  PictureEncoding encoding_ = PictureEncoding::kMjpeg;
  FileHandle file_;
  LockedControls locked_;
  std::vector<std::pair<void*, std::size_t>> buffers_;
  std::optional<std::uint32_t> sequence_;
  CameraCounters counters_;
};

std::string list_formats(const FileHandle& file) {
  std::string text;
  v4l2_fmtdesc format{};
  format.type = V4L2_BUF_TYPE_VIDEO_CAPTURE;
  for (; file.request(VIDIOC_ENUM_FMT, &format) == 0; ++format.index) {
    v4l2_frmsizeenum size{};
    size.pixel_format = format.pixelformat;
    for (; file.request(VIDIOC_ENUM_FRAMESIZES, &size) == 0; ++size.index) {
      if (size.type != V4L2_FRMSIZE_TYPE_DISCRETE) break;
      text += fmt::format("  {} {}x{} at", four_characters(format.pixelformat), size.discrete.width,
                          size.discrete.height);
      v4l2_frmivalenum interval{};
      interval.pixel_format = format.pixelformat;
      interval.width = size.discrete.width;
      interval.height = size.discrete.height;
      for (; file.request(VIDIOC_ENUM_FRAMEINTERVALS, &interval) == 0; ++interval.index) {
        if (interval.type != V4L2_FRMIVAL_TYPE_DISCRETE) break;
        text += fmt::format(" {:.4g}", static_cast<double>(interval.discrete.denominator) /
                                           interval.discrete.numerator);
      }
      text += " Hz\n";
    }
  }
  return text;
}

}  // namespace

std::unique_ptr<Camera> open_v4l2_camera(const RigConfiguration& rig) {
  const std::vector<Found> found = find_cameras(rig.uvc_camera);
  if (found.empty()) {
    throw CameraUnavailable((rig.uvc_camera.device.empty()
                                 ? "the kernel has no camera that fits (/dev/video*)"
                                 : "there is no camera " + rig.uvc_camera.device) +
                            "; uvc_camera --list shows what is there");
  }
  return std::make_unique<V4l2Camera>(found.front(), rig);
}

bool has_v4l2_camera(const UvcCameraConfiguration& wanted) { return !find_cameras(wanted).empty(); }

std::string list_v4l2_cameras() {
  std::string text;
  for (const Found& found : find_cameras({})) {
    text += found.name + "\n";
    try {
      const FileHandle file(found.path);
      text += list_formats(file);
      V4l2Controls controls(file);
      for (const std::string& line : describe_controls(controls)) text += "  " + line + "\n";
    } catch (const CameraUnavailable& why) {
      text += std::string("  ") + why.what() + "\n";
    }
  }
  return text;
}

}  // namespace gastronaut

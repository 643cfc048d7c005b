#include "import/capture_folder.hpp"

#include <filesystem>
#include <map>
#include <stdexcept>

#include "import/files.hpp"
#include "process/channels.hpp"

namespace gastronaut {
namespace {

struct CaptureTransform {
  Eigen::Vector3d t = Eigen::Vector3d::Zero();
  std::vector<double> q_xyzw = {0, 0, 0, 1};

  void check() const {
    if (q_xyzw.size() != 4) throw std::invalid_argument("q_xyzw must have four numbers");
  }
  template <class Visitor>
  void fields(Visitor& v) {
    v("t", t, any(Dimension::kLength));
    v("q_xyzw", q_xyzw);
  }
};

struct CaptureDepth {
  double metres_per_count = 0;
  template <class Visitor>
  void fields(Visitor& v) {
    v("metres_per_count", metres_per_count, positive(Dimension::kLength));
  }
};

// Where the coils stand; what they do is in the matrix.
struct CaptureCoils {
  int rows = 0;
  int cols = 0;
  double pitch = 0;
  double z = 0;
  template <class Visitor>
  void fields(Visitor& v) {
    v("rows", rows, not_negative());
    v("cols", cols, not_negative());
    v("pitch", pitch, not_negative(Dimension::kLength));
    v("z", z, any(Dimension::kLength));
  }
};

struct CaptureCalibration {
  RigConfiguration rig;
  CaptureDepth depth;
  CaptureTransform camera_T_magnet;
  CaptureCoils coils;

  template <class Visitor>
  void fields(Visitor& v) {
    v.section("camera", rig.camera);
    v.section("depth", depth);
    v.section("leds", rig.lights);
    v.section("magnet", rig.magnet);
    v.section("camera_T_magnet", camera_T_magnet);
    v.section("hall", rig.hall_array);
    v.section("coils", coils);
    v("coil_matrix_tesla_per_ampere", rig.coils.tesla_per_ampere, any(Dimension::kFieldPerCurrent));
  }
};

// A default in the place of a calibration would be a wrong measurement.
void require_keys(const YamlSource& source) {
  static const std::map<std::string, std::vector<std::string>> kRequired = {
      {"camera", {"width", "height", "fx", "fy", "cx", "cy", "rate"}},
      {"hall", {"rows", "cols", "pitch", "z", "rate"}},
      {"magnet", {"moment"}}};
  for (const auto& [section, keys] : kRequired) {
    const YAML::Node node = source.root.IsMap() ? source.root[section] : YAML::Node();
    for (const std::string& key : keys) {
      if (!node.IsDefined() || !node.IsMap() || !node[key].IsDefined()) {
        throw ConfigurationError(source.name + ": " + section + "." + key + " is missing");
      }
    }
  }
}

void require(const std::string& folder, const char* name) {
  if (std::filesystem::exists(folder + "/" + name)) return;
  throw std::runtime_error(
      folder + ": " + name +
      " is missing; expected a capture folder: calib.yaml, rgb/NNNNNN.jpg, hall.csv, coils.csv "
      "(where the rig has coils), and for evaluation groundtruth.txt and depth/NNNNNN.png");
}

std::vector<FrameFiles> list_frames(const std::string& folder, double rate, double epoch) {
  std::map<std::int32_t, std::string> depth;
  if (has_part(folder, "depth", channel::kGroundTruthDepth)) {
    for (NumberedFile& file : list_numbered_pictures(folder + "/depth")) {
      depth[file.number] = std::move(file.path);
    }
  }
  std::vector<FrameFiles> frames;
  for (const NumberedFile& file : list_numbered_pictures(folder + "/rgb")) {
    const auto found = depth.find(file.number);
    frames.push_back({to_utime(file.number / rate, epoch), file.number, file.path,
                      found != depth.end() ? found->second : std::string()});
  }
  return frames;
}

}  // namespace

RigConfiguration read_capture_calibration(const std::string& path) {
  const YamlSource source = load_yaml_file(path);
  require_keys(source);
  CaptureCalibration calibration;
  read_configuration(calibration, {source}, {});
  RigConfiguration rig = calibration.rig;
  const std::filesystem::path folder = std::filesystem::absolute(path).parent_path();
  rig.name = folder.filename().string();
  if (calibration.depth.metres_per_count > 0) {
    rig.camera.metres_per_depth_count = calibration.depth.metres_per_count;
  } else if (std::filesystem::exists(folder / "depth")) {
    throw ConfigurationError(path + ": depth.metres_per_count is missing");
  }
  const std::vector<double>& q = calibration.camera_T_magnet.q_xyzw;
  rig.camera_T_magnet.translation = calibration.camera_T_magnet.t;
  rig.camera_T_magnet.rotation = {q[3], q[0], q[1], q[2]};
  const int coils = calibration.coils.rows * calibration.coils.cols;
  if (coils > 0 && rig.coils.tesla_per_ampere.cols() != coils) {
    throw ConfigurationError(path + ": coil_matrix_tesla_per_ampere has " +
                             std::to_string(rig.coils.tesla_per_ampere.cols()) + " columns for " +
                             std::to_string(coils) + " coils");
  }
  try {
    rig.camera_T_magnet.check();
    rig.check();
  } catch (const std::invalid_argument& problem) {
    throw ConfigurationError(path + ": " + problem.what());
  }
  return rig;
}

Recording open_capture_folder(const std::string& folder, const ConfigurationOverrides& overrides,
                              double epoch, Issues& issues) {
  for (const char* name : {"calib.yaml", "rgb", "hall.csv"}) require(folder, name);
  Recording recording;
  RigConfiguration& rig = recording.rig;
  rig = read_capture_calibration(folder + "/calib.yaml");
  std::vector<YamlSource> sources;
  for (const std::string& file : overrides.files) sources.push_back(load_yaml_file(file));
  read_configuration(rig, sources, overrides.settings);

  recording.frames = open_frame_files(list_frames(folder, rig.camera.rate, epoch),
                                      {rig.camera.width, rig.camera.height});
  const auto channels =
      static_cast<std::size_t>(rig.hall_array.num_sensors() * rig.hall_array.num_axes);
  recording.hall = read_series(folder + "/hall.csv", channels, epoch, issues);
  if (const auto coils = static_cast<std::size_t>(rig.coils.tesla_per_ampere.cols()); coils > 0) {
    require(folder, "coils.csv");
    recording.coil_currents = read_series(folder + "/coils.csv", coils, epoch, issues);
  }
  if (has_part(folder, "groundtruth.txt", channel::kGroundTruthPose)) {
    recording.poses = read_poses(folder + "/groundtruth.txt", 1 / rig.camera.rate, epoch, issues);
  }
  return recording;
}

}  // namespace gastronaut

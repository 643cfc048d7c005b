#include "configuration/rig_configuration.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <initializer_list>

namespace gastronaut {

SE3 TransformConfiguration::transform() const {
  return {Eigen::Quaterniond(rotation[0], rotation[1], rotation[2], rotation[3]).normalized(),
          translation};
}

void TransformConfiguration::check() const {
  if (rotation.size() != 4) {
    throw std::invalid_argument("rotation must be a quaternion of four numbers, w x y z");
  }
  const double norm = Eigen::Vector4d(rotation.data()).norm();
  constexpr double kTypedByHand = 1e-3;
  if (std::abs(norm - 1) > kTypedByHand) {
    throw std::invalid_argument("rotation must be a unit quaternion (w x y z); its norm is " +
                                std::to_string(norm));
  }
}

CameraIntrinsics CameraConfiguration::intrinsics() const {
  return {width, height, fx, fy, cx, cy, model, distortion};
}

void CameraConfiguration::check() const {
  CameraModel{intrinsics()};
  if (response.empty()) return;
  if (response.size() < 2 || response.front() != 0 || response.back() != 1) {
    throw std::invalid_argument("response must be two or more numbers from 0 (first) to 1 (last)");
  }
  for (std::size_t i = 1; i < response.size(); ++i) {
    if (response[i] > response[i - 1]) continue;
    throw std::invalid_argument("response must grow from each number to the next");
  }
}

void MagnetConfiguration::check() const {
  if (inner_radius > 0 && inner_radius >= outer_radius) {
    throw std::invalid_argument("the ring's inner_radius must be smaller than its outer_radius");
  }
}

int HallArrayConfiguration::num_sensors() const {
  return sensors.empty() ? rows * cols : static_cast<int>(sensors.size());
}

std::vector<HallSensorConfiguration> HallArrayConfiguration::resolved_sensors() const {
  std::vector<HallSensorConfiguration> resolved = sensors;
  if (resolved.empty()) {
    for (int row = 0; row < rows; ++row) {
      for (int col = 0; col < cols; ++col) {
        HallSensorConfiguration sensor;
        sensor.position = {(row - (rows - 1) / 2.0) * pitch, (col - (cols - 1) / 2.0) * pitch, z};
        if (num_axes == 1) sensor.response = Eigen::RowVector3d::UnitZ();
        resolved.push_back(std::move(sensor));
      }
    }
  }
  for (HallSensorConfiguration& sensor : resolved) {
    if (sensor.offset.empty()) sensor.offset.assign(static_cast<std::size_t>(num_axes), 0.0);
  }
  return resolved;
}

void HallArrayConfiguration::check() const {
  if (num_axes != 1 && num_axes != 3) throw std::invalid_argument("num_axes must be 1 or 3");
  for (std::size_t i = 0; i < sensors.size(); ++i) {
    const HallSensorConfiguration& sensor = sensors[i];
    const std::string who = "sensors[" + std::to_string(i) + "]";
    if (sensor.response.rows() != num_axes || sensor.response.cols() != 3) {
      throw std::invalid_argument(who + ".response must have num_axes = " +
                                  std::to_string(num_axes) + " rows of three numbers");
    }
    if (!sensor.offset.empty() && static_cast<int>(sensor.offset.size()) != num_axes) {
      throw std::invalid_argument(who + ".offset must have num_axes = " + std::to_string(num_axes) +
                                  " numbers");
    }
  }
}

void DepthEstimatorConfiguration::check() const {
  const auto is_albedo = [](double value) { return value > 0 && value <= 1; };
  if (albedo.size() != 3 || !std::all_of(albedo.begin(), albedo.end(), is_albedo)) {
    throw std::invalid_argument("albedo must be three numbers (red, green, blue) above 0, up to 1");
  }
  if (min_depth >= max_depth) throw std::invalid_argument("min_depth must be below max_depth");
  constexpr double kFinestScale = 0.7;
  constexpr double kCoarsestScale = 64;
  const auto is_scale = [](double value) {
    return value >= kFinestScale && value <= kCoarsestScale;
  };
  if (vessel_scales.empty() || !std::all_of(vessel_scales.begin(), vessel_scales.end(), is_scale)) {
    throw std::invalid_argument("vessel_scales must be one or more pixels between 0.7 and 64");
  }
}

void CanHallArrayConfiguration::check() const {
  const auto has = [](const std::string& pattern, const char* part) {
    return pattern.find(part) != std::string::npos;
  };
  if (!has(field_signal, "{sensor}") || !has(field_signal, "{axis}")) {
    throw std::invalid_argument("field_signal must have {sensor} and {axis} in it, not be '" +
                                field_signal + "'");
  }
  if (!status_signal.empty() && !has(status_signal, "{sensor}")) {
    throw std::invalid_argument("status_signal must have {sensor} in it, or be empty, not '" +
                                status_signal + "'");
  }
  if (!current_signal.empty() && !has(current_signal, "{coil}")) {
    throw std::invalid_argument("current_signal must have {coil} in it, or be empty, not '" +
                                current_signal + "'");
  }
  if (counter_signal.empty()) throw std::invalid_argument("counter_signal must not be empty");
}

void UvcCameraConfiguration::check() const {
  const auto one_of = [](const char* name, const std::string& value,
                         std::initializer_list<const char*> choices) {
    std::string listed;
    for (const char* choice : choices) {
      if (value == choice) return;
      listed += (listed.empty() ? "" : ", ") + std::string(choice);
    }
    throw std::invalid_argument(std::string(name) + " must be one of " + listed + ", not '" +
                                value + "'");
  };
  one_of("back_end", back_end, {"auto", "usb", "v4l2"});
  one_of("format", format, {"auto", "mjpeg", "yuyv"});
  const auto identifier = [](const char* name, const std::string& value) {
    const bool is_hexadecimal =
        std::all_of(value.begin(), value.end(), [](unsigned char c) { return std::isxdigit(c); });
    if (value.empty() || (value.size() == 4 && is_hexadecimal)) return;
    throw std::invalid_argument(std::string(name) +
                                " must be four hexadecimal digits in quotes, as lsusb shows them, "
                                "not '" +
                                value + "'");
  };
  identifier("vendor", vendor);
  identifier("product", product);
}

void RigConfiguration::check() const {
  const int pixels_per_grid_pixel =
      (camera.width + depth_estimator.max_width - 1) / depth_estimator.max_width;
  if (camera.height < pixels_per_grid_pixel) {
    throw std::invalid_argument("depth_estimator.max_width leaves no rows of a picture of " +
                                std::to_string(camera.width) + "x" + std::to_string(camera.height) +
                                "; make it larger");
  }
  // The grid that visual_slam will get, see depth_estimator.max_width.
  const int pixels_per_tracked_pixel =
      pixels_per_grid_pixel *
      ((camera.width / pixels_per_grid_pixel + visual_slam.max_width - 1) / visual_slam.max_width);
  constexpr int kLeastTracked = 80;  // pixels
  const int least_side = std::min(camera.width, camera.height);
  if (least_side >= kLeastTracked && least_side / pixels_per_tracked_pixel < kLeastTracked) {
    throw std::invalid_argument(
        "depth_estimator.max_width and visual_slam.max_width leave pictures of less than " +
        std::to_string(kLeastTracked) + " pixels across to track with; make them larger");
  }
  const Eigen::Index channels =
      static_cast<Eigen::Index>(hall_array.num_sensors()) * hall_array.num_axes;
  const Eigen::MatrixXd& matrix = coils.tesla_per_ampere;
  if (matrix.size() != 0 && matrix.rows() != channels) {
    throw std::invalid_argument("coils.tesla_per_ampere has " + std::to_string(matrix.rows()) +
                                " rows, but the Hall array has " + std::to_string(channels) +
                                " channels (one row a channel)");
  }
}

RigConfiguration load_rig_configuration(const std::vector<std::string>& files,
                                        const std::vector<std::string>& settings) {
  return parse_rig_configuration("", "defaults", settings, files);
}

RigConfiguration parse_rig_configuration(const std::string& yaml, const std::string& name,
                                         const std::vector<std::string>& settings,
                                         const std::vector<std::string>& files) {
  std::vector<YamlSource> sources = {parse_yaml(yaml, name)};
  for (const std::string& file : files) sources.push_back(load_yaml_file(file));
  RigConfiguration configuration;
  read_configuration(configuration, sources, settings);
  return configuration;
}

}  // namespace gastronaut

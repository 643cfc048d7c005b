#include "configuration/rig_configuration.hpp"

#include <cmath>

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

void CameraConfiguration::check() const { CameraModel{intrinsics()}; }

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

void RigConfiguration::check() const {
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

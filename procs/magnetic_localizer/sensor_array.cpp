#include "magnetic_localizer/sensor_array.hpp"

#include <cmath>

namespace gastronaut::magnetics {

SensorArray::SensorArray(const HallArrayConfiguration& configuration)
    : num_sensors(configuration.num_sensors()), num_axes(configuration.num_axes) {
  for (auto& coordinate : position) coordinate.resize(num_sensors);
  for (auto& entry : response) entry.setZero(num_sensors);
  offset.setZero(3 * num_sensors);
  const std::vector<HallSensorConfiguration> sensors = configuration.resolved_sensors();
  for (Eigen::Index s = 0; s < num_sensors; ++s) {
    const HallSensorConfiguration& sensor = sensors[static_cast<std::size_t>(s)];
    for (std::size_t k = 0; k < 3; ++k) position[k][s] = sensor.position[static_cast<int>(k)];
    for (Eigen::Index axis = 0; axis < num_axes; ++axis) {
      for (Eigen::Index k = 0; k < 3; ++k) {
        response[static_cast<std::size_t>(3 * axis + k)][s] = sensor.response(axis, k);
      }
      offset[channel(s, axis)] = sensor.offset[static_cast<std::size_t>(axis)];
    }
  }
}

Eigen::Vector3d SensorArray::centre() const {
  return {position[0].mean(), position[1].mean(), position[2].mean()};
}

ReadingCleaner::ReadingCleaner(const RigConfiguration& configuration)
    : array_(configuration.hall_array),
      saturation_(configuration.hall_array.saturation),
      current_variance_(configuration.coils.current_noise * configuration.coils.current_noise),
      matrix_variance_(configuration.coils.tesla_per_ampere_std *
                       configuration.coils.tesla_per_ampere_std) {
  const Eigen::MatrixXd& matrix = configuration.coils.tesla_per_ampere;
  tesla_per_ampere_.setZero(3 * array_.num_sensors, matrix.cols());
  if (matrix.size() > 0) {
    for (Eigen::Index s = 0; s < array_.num_sensors; ++s) {
      for (Eigen::Index axis = 0; axis < array_.num_axes; ++axis) {
        tesla_per_ampere_.row(array_.channel(s, axis)) = matrix.row(s * array_.num_axes + axis);
      }
    }
  }
  variance_by_current_ = current_variance_ * tesla_per_ampere_.rowwise().squaredNorm();
}

void ReadingCleaner::clean(const HallReading& reading,
                           const std::optional<Eigen::VectorXd>& currents,
                           CleanReading& clean) const {
  clean.value = -array_.offset;
  clean.variance.setZero(3 * array_.num_sensors);
  clean.usable.setZero(3 * array_.num_sensors);
  clean.num_usable = 0;
  if (currents) {
    clean.value.noalias() -= tesla_per_ampere_ * *currents;
    clean.variance = variance_by_current_.array() + matrix_variance_ * currents->squaredNorm();
  }
  for (Eigen::Index s = 0; s < array_.num_sensors; ++s) {
    for (Eigen::Index axis = 0; axis < array_.num_axes; ++axis) {
      const double field = reading.field[s * array_.num_axes + axis];
      const Eigen::Index c = array_.channel(s, axis);
      // Written so that a NaN is not usable.
      if (reading.status[s] == 0 && std::abs(field) < saturation_) {
        clean.value[c] += field;
        clean.usable[c] = 1;
        ++clean.num_usable;
      } else {
        clean.value[c] = 0;
      }
    }
  }
}

}  // namespace gastronaut::magnetics

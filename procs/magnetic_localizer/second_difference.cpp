#include "magnetic_localizer/second_difference.hpp"

#include <Eigen/LU>
#include <algorithm>

namespace gastronaut::magnetics {
namespace {

using Triplets = std::vector<Eigen::Triplet<double>>;

// Sensors may be this part of the pitch off their grid points.
constexpr double kGridTolerance = 0.02;

struct Grid {
  int rows, cols;
  double row_spacing, col_spacing;  // metres
};

Grid check_grid(const HallArrayConfiguration& configuration) {
  const std::string advice = "; magnetic_localizer.estimator: full_field takes any array";
  if (configuration.num_sensors() != configuration.rows * configuration.cols) {
    throw ConfigurationError("second_difference needs hall_array.rows x hall_array.cols sensors" +
                             advice);
  }
  if (configuration.rows < 3 || configuration.cols < 3) {
    throw ConfigurationError("second_difference needs a grid of at least 3 x 3 sensors" + advice);
  }
  const std::vector<HallSensorConfiguration> sensors = configuration.resolved_sensors();
  const auto position = [&](int row, int col) {
    return sensors[static_cast<std::size_t>(row * configuration.cols + col)].position;
  };
  const Eigen::Vector3d origin = position(0, 0);
  const Eigen::Vector3d row_step =
      (position(configuration.rows - 1, 0) - origin) / (configuration.rows - 1);
  const Eigen::Vector3d col_step =
      (position(0, configuration.cols - 1) - origin) / (configuration.cols - 1);
  const double tolerance = kGridTolerance * std::min(row_step.norm(), col_step.norm());
  bool regular =
      std::abs(row_step.dot(col_step)) <= kGridTolerance * row_step.norm() * col_step.norm();
  for (int row = 0; row < configuration.rows; ++row) {
    for (int col = 0; col < configuration.cols; ++col) {
      const Eigen::Vector3d expected = origin + row * row_step + col * col_step;
      regular = regular && (position(row, col) - expected).norm() <= tolerance;
    }
  }
  if (!regular) {
    throw ConfigurationError(
        "second_difference needs sensors on a regular, rectangular grid, "
        "row by row" +
        advice);
  }
  return {configuration.rows, configuration.cols, row_step.norm(), col_step.norm()};
}

// What turns a sensor's reading into the field components that are differenced: along the rig's
// axes where there are three, along the sensor's own where there is one.
Eigen::MatrixXd reading_to_field(const SensorArray& array, Eigen::Index sensor) {
  Eigen::MatrixXd response(array.num_axes, 3);
  for (Eigen::Index axis = 0; axis < array.num_axes; ++axis) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      response(axis, k) = array.response[static_cast<std::size_t>(3 * axis + k)][sensor];
    }
  }
  if (array.num_axes == 1) return Eigen::MatrixXd::Constant(1, 1, 1 / response.norm());
  return response.inverse();
}

}  // namespace

SecondDifference::SecondDifference(const SensorArray& array, const MagnetModel& model,
                                   const HallArrayConfiguration& configuration,
                                   double background_std)
    : num_sensors_(array.num_sensors),
      num_axes_(array.num_axes),
      model_(model),
      centre_(array.centre()),
      background_std_(background_std),
      field_(array.num_sensors) {
  const Grid grid = check_grid(configuration);
  const double by_row = 1 / (grid.row_spacing * grid.row_spacing);
  const double by_col = 1 / (grid.col_spacing * grid.col_spacing);
  Triplets differences;
  int count = 0;
  for (Eigen::Index component = 0; component < num_axes_; ++component) {
    for (int row = 1; row + 1 < grid.rows; ++row) {
      for (int col = 1; col + 1 < grid.cols; ++col, ++count) {
        const auto add = [&](int r, int c, double weight) {
          const Eigen::Index sensor = r * grid.cols + c;
          const Eigen::MatrixXd to_field = reading_to_field(array, sensor);
          for (Eigen::Index axis = 0; axis < num_axes_; ++axis) {
            differences.emplace_back(count, static_cast<int>(array.channel(sensor, axis)),
                                     weight * to_field(component, axis));
          }
        };
        add(row, col, 2 * (by_row + by_col));
        add(row - 1, col, -by_row);
        add(row + 1, col, -by_row);
        add(row, col - 1, -by_col);
        add(row, col + 1, -by_col);
      }
    }
  }
  differences_.resize(count, 3 * num_sensors_);
  differences_.setFromTriplets(differences.begin(), differences.end());
  Triplets response;
  for (Eigen::Index s = 0; s < num_sensors_; ++s) {
    for (Eigen::Index axis = 0; axis < num_axes_; ++axis) {
      for (Eigen::Index k = 0; k < 3; ++k) {
        response.emplace_back(static_cast<int>(array.channel(s, axis)),
                              static_cast<int>(k * num_sensors_ + s),
                              array.response[static_cast<std::size_t>(3 * axis + k)][s]);
      }
    }
  }
  Eigen::SparseMatrix<double, Eigen::RowMajor> responses(3 * num_sensors_, 3 * num_sensors_);
  responses.setFromTriplets(response.begin(), response.end());
  field_differences_ = differences_ * responses;
}

void SecondDifference::set_reading(const CleanReading& reading, const SensorMatrices& covariance,
                                   const FieldInformation& /*information*/) {
  using Entry = Eigen::SparseMatrix<double, Eigen::RowMajor>::InnerIterator;
  Triplets rows;
  int used = 0;
  for (int row = 0; row < differences_.rows(); ++row) {
    bool usable = true;
    for (Entry entry(differences_, row); entry; ++entry) {
      usable = usable && reading.usable[entry.col()] > 0;
    }
    if (usable) rows.emplace_back(used++, row, 1.0);
  }
  Eigen::SparseMatrix<double, Eigen::RowMajor> selection(used, differences_.rows());
  selection.setFromTriplets(rows.begin(), rows.end());
  const Eigen::SparseMatrix<double, Eigen::RowMajor> differences = selection * differences_;
  used_field_differences_ = selection * field_differences_;

  // Three axes of one sensor share errors; sensors do not.
  constexpr int kEntry[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
  Triplets noise;
  for (Eigen::Index s = 0; s < num_sensors_; ++s) {
    for (Eigen::Index i = 0; i < num_axes_; ++i) {
      for (Eigen::Index j = 0; j < num_axes_; ++j) {
        noise.emplace_back(static_cast<int>(i * num_sensors_ + s),
                           static_cast<int>(j * num_sensors_ + s),
                           covariance[static_cast<std::size_t>(kEntry[i][j])][s]);
      }
    }
  }
  Eigen::SparseMatrix<double, Eigen::RowMajor> channel_noise(3 * num_sensors_, 3 * num_sensors_);
  channel_noise.setFromTriplets(noise.begin(), noise.end());
  Eigen::MatrixXd total = Eigen::MatrixXd(differences * channel_noise * differences.transpose());
  // Where sensors differ in direction the background does not cancel to the last bit.
  Eigen::MatrixXd uniform = Eigen::MatrixXd::Zero(3 * num_sensors_, 3);
  for (Eigen::Index k = 0; k < 3; ++k)
    uniform.col(k).segment(k * num_sensors_, num_sensors_).setOnes();
  const Eigen::MatrixXd leak = background_std_ * (used_field_differences_ * uniform);
  total += leak * leak.transpose();
  noise_.compute(total);
  observed_ = noise_.matrixL().solve(differences * reading.value);
}

void SecondDifference::evaluate(const MagnetState& state, NormalEquations& equations) {
  MagnetState magnet = state;
  magnet.background.setZero();
  model_.field_and_derivatives(magnet, field_);
  const Eigen::VectorXd residual =
      observed_ - noise_.matrixL().solve(used_field_differences_ * field_.field);
  const Eigen::MatrixXd derivatives =
      noise_.matrixL().solve(used_field_differences_ * field_.by_unknown);
  equations.information.setZero();
  equations.gradient.setZero();
  equations.information.topLeftCorner<kNumMagnetUnknowns, kNumMagnetUnknowns>() =
      derivatives.transpose() * derivatives;
  equations.gradient.head<kNumMagnetUnknowns>() = derivatives.transpose() * residual;
  equations.misfit = residual.squaredNorm();
}

}  // namespace gastronaut::magnetics

#include "evaluate/cramer_rao.hpp"

#include <gtest/gtest.h>

#include <Eigen/LU>
#include <cmath>

#include "random_numbers.hpp"

namespace gastronaut::evaluation {
namespace {

const Eigen::Vector3d kPosition(0.01, -0.02, 0.02);  // metres, 65 mm below the array
const Eigen::Vector3d kAxis = Eigen::Vector3d(0.3, -0.5, 0.8).normalized();

RigConfiguration rig() {
  RigConfiguration configuration;
  Draws draws(5);
  configuration.coils.tesla_per_ampere.resize(3 * configuration.hall_array.num_sensors(), 9);
  for (double& entry : configuration.coils.tesla_per_ampere.reshaped()) {
    entry = 1e-4 * draws.normal();
  }
  configuration.magnetic_localizer.estimate_moment = true;
  return configuration;
}

// Field of the magnet at a sensor, moved and turned a little, plus background.
Eigen::Vector3d field_at(const RigConfiguration& configuration, const Eigen::Vector3d& sensor,
                         const Eigen::Matrix<double, 9, 1>& change) {
  const Eigen::Vector3d axis = so3_exp(perpendicular_basis(kAxis) * change.segment<2>(3)) * kAxis;
  return axial_magnet_field(sensor - kPosition - change.head<3>(),
                            (configuration.magnet.moment + change[8]) * axis,
                            octupole_ratio(configuration.magnet.shape())) +
         change.segment<3>(5);
}

// The textbook formula with everything written out: numerical derivatives and one dense covariance
// of all channels.
Matrix5d textbook_bound(const RigConfiguration& configuration) {
  const auto sensors = configuration.hall_array.resolved_sensors();
  const auto& array = configuration.hall_array;
  const auto channels = static_cast<Eigen::Index>(3 * sensors.size());
  Eigen::MatrixXd jacobian(channels, 9);
  const Eigen::MatrixXd coil_noise =
      configuration.coils.tesla_per_ampere * configuration.coils.current_noise;
  Eigen::MatrixXd covariance = coil_noise * coil_noise.transpose();
  Eigen::Matrix<double, 9, 1> step;  // central differences: metres, radians, tesla, A m^2
  step << 1e-6, 1e-6, 1e-6, 1e-5, 1e-5, 1e-6, 1e-6, 1e-6, 1e-5;
  for (Eigen::Index s = 0; s < static_cast<Eigen::Index>(sensors.size()); ++s) {
    const auto& sensor = sensors[static_cast<std::size_t>(s)];
    for (Eigen::Index k = 0; k < 9; ++k) {
      Eigen::Matrix<double, 9, 1> change = Eigen::Matrix<double, 9, 1>::Zero();
      change[k] = step[k];
      jacobian.block<3, 1>(3 * s, k) = sensor.response *
                                       (field_at(configuration, sensor.position, change) -
                                        field_at(configuration, sensor.position, -change)) /
                                       (2 * step[k]);
    }
    const Eigen::Vector3d field =
        field_at(configuration, sensor.position, Eigen::Matrix<double, 9, 1>::Zero());
    // A small turn w changes the field that the sensor sees by w x B.
    Eigen::Matrix3d block =
        std::pow(array.alignment_std, 2) * skew(field) * skew(field).transpose();
    for (int axis = 0; axis < 3; ++axis) {
      block(axis, axis) += std::pow(array.noise, 2) + std::pow(array.offset_std, 2) +
                           std::pow(array.gain_std * field[axis], 2);
    }
    covariance.block<3, 3>(3 * s, 3 * s) += block;
  }
  Eigen::MatrixXd information = jacobian.transpose() * covariance.inverse() * jacobian;
  for (Eigen::Index k = 5; k < 8; ++k) {
    information(k, k) += 1 / std::pow(configuration.magnetic_localizer.background_std, 2);
  }
  information(8, 8) += 1 / std::pow(configuration.magnet.moment_std, 2);
  return information.inverse().topLeftCorner<5, 5>();
}

TEST(CramerRaoTest, EqualsTheDenseTextbookFormula) {
  const RigConfiguration configuration = rig();
  const Matrix5d expected = textbook_bound(configuration);
  const Matrix5d bound = CramerRaoBound(configuration, CramerRaoBound::Noise::kConfigured)
                             .covariance(kPosition, kAxis);
  // Numerical derivatives and the inverse of a 192 x 192 matrix over nine orders of magnitude.
  constexpr double kRelative = 1e-4;
  for (int k = 0; k < 5; ++k) {
    EXPECT_NEAR(bound(k, k), expected(k, k), kRelative * expected(k, k));
  }
  const double position_difference = (bound - expected).topLeftCorner(3, 3).norm();
  EXPECT_LT(position_difference, kRelative * expected.topLeftCorner(3, 3).norm());
  EXPECT_LT((bound - bound.transpose()).norm(), kRelative * bound.norm());
}

TEST(CramerRaoTest, SensorNoiseAloneScalesTheBound) {
  RigConfiguration configuration = rig();
  configuration.magnetic_localizer.estimate_moment = false;
  configuration.magnetic_localizer.background_std = 1;  // no prior to speak of
  const auto bound = [&] {
    return CramerRaoBound(configuration, CramerRaoBound::Noise::kSensorOnly)
        .covariance(kPosition, kAxis);
  };
  const Matrix5d before = bound();
  configuration.hall_array.noise *= 3;
  constexpr double kPriorIsNegligible = 1e-6;
  EXPECT_LT((bound() - 9 * before).norm(), kPriorIsNegligible * before.norm());
  const Matrix5d configured = CramerRaoBound(configuration, CramerRaoBound::Noise::kConfigured)
                                  .covariance(kPosition, kAxis);
  for (int k = 0; k < 5; ++k) EXPECT_GT(configured(k, k), before(k, k));
}

TEST(CramerRaoTest, ChannelsThatAreNotUsedTellNothing) {
  const RigConfiguration configuration = rig();
  const CramerRaoBound bound(configuration, CramerRaoBound::Noise::kConfigured);
  std::vector<int> unused;
  const int channels = 3 * configuration.hall_array.num_sensors();
  for (int channel = 0; channel < channels; channel += 2) unused.push_back(channel);
  const Matrix5d all = bound.covariance(kPosition, kAxis);
  const Matrix5d half = bound.covariance(kPosition, kAxis, unused);
  for (int k = 0; k < 5; ++k) EXPECT_GT(half(k, k), all(k, k));
  unused.clear();
  for (int channel = 0; channel < channels; ++channel) unused.push_back(channel);
  EXPECT_TRUE(std::isinf(bound.covariance(kPosition, kAxis, unused)(0, 0)));
}

TEST(CramerRaoTest, WorksForMonoAxialArraysWithoutCoils) {
  RigConfiguration configuration;
  configuration.hall_array.num_axes = 1;
  const Matrix5d mono = CramerRaoBound(configuration, CramerRaoBound::Noise::kConfigured)
                            .covariance(kPosition, kAxis);
  configuration.hall_array.num_axes = 3;
  const Matrix5d three = CramerRaoBound(configuration, CramerRaoBound::Noise::kConfigured)
                             .covariance(kPosition, kAxis);
  EXPECT_TRUE(mono.allFinite());
  for (int k = 0; k < 5; ++k) EXPECT_GT(mono(k, k), three(k, k));
}

}  // namespace
}  // namespace gastronaut::evaluation

#include "magnetic_localizer/full_field.hpp"

namespace gastronaut::magnetics {
FullField::FullField(const SensorArray& array, const MagnetModel& model)
    : model_(model),
      centre_(array.centre()),
      field_(array.num_sensors),
      residual_(3 * array.num_sensors),
      weighted_(3 * array.num_sensors, kNumMagnetUnknowns) {}

void FullField::set_reading(const CleanReading& reading, const SensorMatrices& /*covariance*/,
                            const FieldInformation& information) {
  information_ = &information;
  num_observations_ = reading.num_usable;
  scalar_ = information.scalar.sum();
  const SensorMatrices& g = information.matrix;
  background_matrix_ << g[0].sum(), g[1].sum(), g[2].sum(),  //
      g[1].sum(), g[3].sum(), g[4].sum(),                    //
      g[2].sum(), g[4].sum(), g[5].sum();
}

void FullField::evaluate(const MagnetState& state, NormalEquations& equations) {
  model_.field_and_derivatives(state, field_);
  apply_information(information_->matrix, field_.field.data(), residual_.data());
  const Eigen::VectorXd& h = information_->vector;
  // c - B.(2 h - G B)
  equations.misfit = scalar_ - 2 * field_.field.dot(h) + field_.field.dot(residual_);
  residual_ = h - residual_;
  const Eigen::Index n = h.size() / 3;
  for (int j = 0; j < kNumMagnetUnknowns; ++j) {
    apply_information(information_->matrix, field_.by_unknown.col(j).data(),
                      weighted_.col(j).data());
    for (int i = 0; i <= j; ++i) {
      const double entry = field_.by_unknown.col(i).dot(weighted_.col(j));
      equations.information(i, j) = entry;
      equations.information(j, i) = entry;
    }
    for (int k = 0; k < 3; ++k) {
      const double entry = weighted_.col(j).segment(k * n, n).sum();
      equations.information(kBackground + k, j) = entry;
      equations.information(j, kBackground + k) = entry;
    }
    equations.gradient[j] = field_.by_unknown.col(j).dot(residual_);
  }
  for (int k = 0; k < 3; ++k) {
    equations.gradient[kBackground + k] = residual_.segment(k * n, n).sum();
  }
  equations.information.block<3, 3>(kBackground, kBackground) = background_matrix_;
}

}  // namespace gastronaut::magnetics

// Whether covariances can be believed: the normalised estimation error squared (NEES), Bar-Shalom,
// Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation", 5.4.2.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

namespace gastronaut::evaluation {

// e^T P^-1 e; nothing where P is not positive definite.
std::optional<double> normalised_error_squared(const Eigen::VectorXd& error,
                                               const Eigen::MatrixXd& covariance);

// Value below which a chi-square variable of that many degrees of freedom lies with the
// probability (0..1, both exclusive).
double chi_square_quantile(double probability, double degrees_of_freedom);

struct Consistency {
  std::size_t count = 0;
  double mean = 0;  // the degrees of freedom when the covariances are right
  double median = 0;
  double band_low = 0;  // where the mean of that many independent errors lies in 95 % of cases
  double band_high = 0;
  double share_inside = 0;  // of the single values inside their own 95 % band; 0.95 when right
};
Consistency consistency(std::span<const double> normalised_errors, int degrees_of_freedom);

}  // namespace gastronaut::evaluation

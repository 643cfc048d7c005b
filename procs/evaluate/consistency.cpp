#include "evaluate/consistency.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <unsupported/Eigen/SpecialFunctions>

#include "evaluate/trajectory_errors.hpp"

namespace gastronaut::evaluation {
namespace {
constexpr double kLowTail = 0.025;  // of the 95 % bands
constexpr double kHighTail = 0.975;
}  // namespace

std::optional<double> normalised_error_squared(const Eigen::VectorXd& error,
                                               const Eigen::MatrixXd& covariance) {
  const Eigen::LLT<Eigen::MatrixXd> factor(covariance);
  if (!covariance.allFinite() || factor.info() != Eigen::Success) return std::nullopt;
  return factor.matrixL().solve(error).squaredNorm();
}

double chi_square_quantile(double probability, double degrees_of_freedom) {
  const auto below = [&](double x) {
    return Eigen::numext::igamma(degrees_of_freedom / 2, x / 2) < probability;
  };
  double low = 0;
  double high = degrees_of_freedom + 1;
  while (below(high)) high *= 2;
  // Bisection down to the spacing of doubles.
  for (double middle = (low + high) / 2; middle > low && middle < high; middle = (low + high) / 2) {
    (below(middle) ? low : high) = middle;
  }
  return high;
}

Consistency consistency(std::span<const double> normalised_errors, int degrees_of_freedom) {
  const Statistics all = statistics(normalised_errors);
  Consistency result{all.count, all.mean, all.median, all.mean, all.mean, all.mean};
  if (all.count == 0) return result;
  const auto count = static_cast<double>(all.count);
  result.band_low = chi_square_quantile(kLowTail, count * degrees_of_freedom) / count;
  result.band_high = chi_square_quantile(kHighTail, count * degrees_of_freedom) / count;
  const double low = chi_square_quantile(kLowTail, degrees_of_freedom);
  const double high = chi_square_quantile(kHighTail, degrees_of_freedom);
  const auto inside = std::count_if(normalised_errors.begin(), normalised_errors.end(),
                                    [&](double value) { return value >= low && value <= high; });
  result.share_inside = static_cast<double>(inside) / count;
  return result;
}

}  // namespace gastronaut::evaluation

#include "calibrate/light_model.hpp"

#include <algorithm>
#include <cmath>

namespace gastronaut {

ResponseCurve ResponseCurve::with_gamma(double gamma) {
  ResponseCurve curve;
  curve.set_parameters(Eigen::VectorXd::Constant(1, std::log(gamma)));
  return curve;
}

ResponseCurve ResponseCurve::with_table(const std::vector<double>& table) {
  ResponseCurve curve;
  curve.is_table_ = true;
  Eigen::VectorXd logarithms(static_cast<Eigen::Index>(table.size()) - 1);
  for (Eigen::Index k = 0; k < logarithms.size(); ++k) {
    const auto knot = static_cast<std::size_t>(k);
    logarithms(k) = std::log(table[knot + 1] - table[knot]);
  }
  curve.set_parameters(logarithms);
  return curve;
}

void ResponseCurve::set_parameters(const Eigen::VectorXd& parameters) {
  parameters_ = parameters;
  if (!is_table_) return;
  const Eigen::VectorXd shares = (parameters.array() - parameters.maxCoeff()).exp();
  const double sum = shares.sum();
  table_.assign(1, 0);
  increments_.clear();
  for (const double share : shares) {
    increments_.push_back(share / sum);
    table_.push_back(table_.back() + increments_.back());
  }
  table_.back() = 1;  // but for rounding it is
}

double ResponseCurve::gamma() const { return std::exp(parameters_(0)); }
std::vector<double> ResponseCurve::table() const { return table_; }

double ResponseCurve::light(double level) const {
  if (!is_table_) return std::pow(level, gamma());
  const double place = level * static_cast<double>(increments_.size());
  const auto knot = std::min(static_cast<std::size_t>(place), increments_.size() - 1);
  return table_[knot] + (place - static_cast<double>(knot)) * increments_[knot];
}

ResponseCurve::Level ResponseCurve::level(double light, double* by_parameters) const {
  Level result;
  if (!is_table_) {
    const double exponent = 1 / gamma();
    result.level = std::pow(light, exponent);
    result.slope = exponent * result.level / light;
    if (by_parameters != nullptr) *by_parameters = -exponent * std::log(light) * result.level;
  } else {
    const auto count = increments_.size();
    const auto above = std::upper_bound(table_.begin(), table_.end(), light);
    const auto knot =
        std::min(static_cast<std::size_t>(std::max<std::ptrdiff_t>(above - table_.begin(), 1)),
                 count) -
        1;
    const double along = (light - table_[knot]) / increments_[knot];
    result.level = (static_cast<double>(knot) + along) / static_cast<double>(count);
    result.slope = 1 / (static_cast<double>(count) * increments_[knot]);
    if (by_parameters != nullptr) {
      // What the light of this level would change by, turned into levels.
      for (std::size_t j = 0; j < count; ++j) {
        const double part = j < knot ? 1 : j == knot ? along : 0;
        by_parameters[j] = -result.slope * increments_[j] * (part - light);
      }
    }
  }
  const double exponent = result.slope * light / result.level;
  result.curvature = exponent * (exponent - 1) * result.level / (light * light);
  return result;
}

Shading shade(const Eigen::Vector3d& ray, const Eigen::Vector3d& plane,
              const std::vector<Eigen::Vector3d>& lights, double lobe) {
  Shading shading;
  const double inverse_depth = plane.dot(ray);
  if (!(inverse_depth > 0)) return shading;
  const double depth = 1 / inverse_depth;
  const Eigen::Vector3d point = depth * ray;
  double sum = 0;
  double by_lobe = 0;
  double by_depth = 0;
  Eigen::Vector3d by_facing = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& light : lights) {
    const double facing = 1 - plane.dot(light);
    if (facing <= 0) return shading;
    const Eigen::Vector3d way = point - light;
    const double distance = way.norm();
    const double cosine = depth / distance;
    const double part = std::pow(cosine, lobe) * facing / (distance * distance * distance);
    sum += part;
    by_lobe += part * std::log(cosine);
    by_depth += part * (lobe / depth - (lobe + 3) * way.dot(ray) / (distance * distance));
    by_facing -= part / facing * light;
  }
  shading.lit = true;
  shading.log_light = std::log(sum / plane.norm());
  shading.by_lobe = by_lobe / sum;
  shading.by_plane =
      -by_depth / sum * depth * depth * ray + by_facing / sum - plane / plane.squaredNorm();
  return shading;
}

}  // namespace gastronaut

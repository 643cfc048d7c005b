// The picture of a small flat patch in the light of the capsule's own lamps, with its derivatives
// by everything that `calibrate light` estimates.
//
// A patch is a plane m . X = 1 in the camera frame (m in 1/metres: the direction away from the lens
// over the distance), seen along the ray r = (x, y, 1), lit by lights L_k in the plane of the lens:
//   P = r / (m . r),  rho_k = |P - L_k|,
//   S = sum over k of P_z^lobe rho_k^(-lobe - 3) (1 - m . L_k) / |m|,
//   light = exposure * power * cos^vignetting(r) * S,  level = response^-1(light),
// which is NearLight's equation with power = led_intensity * albedo.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace gastronaut {

// The camera's response as a curve from light to level, both 0 to 1. Parametrised so that it stays
// monotone whatever the parameters are: log gamma, or the logarithms of a table's increments (up to
// a common addend, which does not matter).
class ResponseCurve {
 public:
  static ResponseCurve with_gamma(double gamma);
  // L at equally spaced levels, growing from 0 to 1.
  static ResponseCurve with_table(const std::vector<double>& table);

  Eigen::Index num_parameters() const { return parameters_.size(); }
  const Eigen::VectorXd& parameters() const { return parameters_; }
  void set_parameters(const Eigen::VectorXd& parameters);

  bool is_table() const { return is_table_; }
  double gamma() const;               // only without a table
  std::vector<double> table() const;  // only with one
  // Linear light of a level.
  double light(double level) const;

  struct Level {
    double level = 0;
    double slope = 0;      // d level / d light
    double curvature = 0;  // its derivative, that of the power law that fits here
  };
  // `light` may lie beyond 1, where the curve goes on as it ends. `by_parameters`, where wanted,
  // has num_parameters() places.
  Level level(double light, double* by_parameters = nullptr) const;

 private:
  bool is_table_ = false;
  Eigen::VectorXd parameters_;
  std::vector<double> table_;       // the table's lights, its first being 0
  std::vector<double> increments_;  // table_[k + 1] - table_[k]
};

// log S and its derivatives. Throws nothing; `lit` is false where the patch is behind the lens or
// turned away from a light.
struct Shading {
  bool lit = false;
  double log_light = 0;
  double by_lobe = 0;
  Eigen::Vector3d by_plane = Eigen::Vector3d::Zero();  // metres
};
Shading shade(const Eigen::Vector3d& ray, const Eigen::Vector3d& plane,
              const std::vector<Eigen::Vector3d>& lights, double lobe);

}  // namespace gastronaut

#include "magnetic_localizer/magnet_model.hpp"

#include <cmath>

#include "geometry/se3.hpp"
#include "magnetics/dipole.hpp"

namespace gastronaut::magnetics {

MagnetState moved(const MagnetState& state, const UnknownVector& step) {
  MagnetState result = state;
  result.position += step.segment<3>(kPosition);
  const Eigen::Vector3d rotation = perpendicular_basis(state.axis) * step.segment<2>(kRotation);
  result.axis = (so3_exp(rotation) * state.axis).normalized();
  result.moment += step[kMoment];
  result.background += step.segment<3>(kBackground);
  return result;
}

void MagnetModel::field(const MagnetState& state, Eigen::VectorXd& field) const {
  const Eigen::Index n = array_.num_sensors;
  field.resize(3 * n);
  const double* const px = array_.position[0].data();
  const double* const py = array_.position[1].data();
  const double* const pz = array_.position[2].data();
  double* const bx = field.data();
  double* const by = bx + n;
  double* const bz = by + n;
  const Eigen::Vector3d p = state.position;
  const Eigen::Vector3d a = state.axis;
  const Eigen::Vector3d background = state.background;
  const double scale = kMagneticConstantOver4Pi * state.moment;
  const double q = octupole_ratio_;
#pragma GCC ivdep
  for (Eigen::Index i = 0; i < n; ++i) {
    const double dx = px[i] - p.x();
    const double dy = py[i] - p.y();
    const double dz = pz[i] - p.z();
    const double s = a.x() * dx + a.y() * dy + a.z() * dz;
    const double s2 = s * s;
    const double i2 = 1 / (dx * dx + dy * dy + dz * dz);
    const double i3 = i2 * std::sqrt(i2);
    const double i5 = i3 * i2;
    const double q7 = q * i5 * i2;
    const double alpha = scale * (-i3 + 1.5 * q * i5 - 7.5 * s2 * q7);
    const double beta = scale * s * (3 * i5 + q7 * (17.5 * s2 * i2 - 7.5));
    bx[i] = alpha * a.x() + beta * dx + background.x();
    by[i] = alpha * a.y() + beta * dy + background.y();
    bz[i] = alpha * a.z() + beta * dz + background.z();
  }
}

void MagnetModel::field_and_derivatives(const MagnetState& state, ArrayField& result) const {
  const Eigen::Index n = array_.num_sensors;
  const double* const px = array_.position[0].data();
  const double* const py = array_.position[1].data();
  const double* const pz = array_.position[2].data();
  double* const b = result.field.data();
  double* const by_x = result.by_unknown.col(kPosition).data();
  double* const by_y = result.by_unknown.col(kPosition + 1).data();
  double* const by_z = result.by_unknown.col(kPosition + 2).data();
  double* const by_first = result.by_unknown.col(kRotation).data();
  double* const by_second = result.by_unknown.col(kRotation + 1).data();
  double* const by_moment = result.by_unknown.col(kMoment).data();
  const Eigen::Vector3d p = state.position;
  const Eigen::Vector3d a = state.axis;
  const Eigen::Vector3d background = state.background;
  // Turning about the first basis vector moves the axis against the second, and so on.
  const Eigen::Matrix<double, 3, 2> basis = perpendicular_basis(a);
  const Eigen::Vector3d u = -basis.col(1);
  const Eigen::Vector3d v = basis.col(0);
  const double moment = state.moment;
  const double q = octupole_ratio_;
#pragma GCC ivdep
  for (Eigen::Index i = 0; i < n; ++i) {
    const double dx = px[i] - p.x();
    const double dy = py[i] - p.y();
    const double dz = pz[i] - p.z();
    const double s = a.x() * dx + a.y() * dy + a.z() * dz;
    const double s2 = s * s;
    const double i2 = 1 / (dx * dx + dy * dy + dz * dz);
    const double i3 = kMagneticConstantOver4Pi * i2 * std::sqrt(i2);
    const double i5 = i3 * i2;
    const double q7 = q * i5 * i2;
    const double q9 = q7 * i2;
    const double alpha = -i3 + 1.5 * q * i5 - 7.5 * s2 * q7;
    const double beta = s * (3 * i5 + 17.5 * s2 * q9 - 7.5 * q7);
    const double fx = alpha * a.x() + beta * dx;
    const double fy = alpha * a.y() + beta * dy;
    const double fz = alpha * a.z() + beta * dz;
    b[i] = moment * fx + background.x();
    b[i + n] = moment * fy + background.y();
    b[i + 2 * n] = moment * fz + background.z();
    by_moment[i] = fx;
    by_moment[i + n] = fy;
    by_moment[i + 2 * n] = fz;

    // d alpha/ds and d beta/ds along the axis; d alpha/dd and d beta/dd along d. The second of the
    // first pair equals the first of the second: the field has no curl.
    const double alpha_s = -15 * moment * s * q7;
    const double shared = moment * (3 * i5 + 52.5 * s2 * q9 - 7.5 * q7);
    const double beta_d = moment * s * (-15 * i5 * i2 + 52.5 * q9 - 157.5 * s2 * q9 * i2);
    const double wx = alpha_s * a.x() + shared * dx;
    const double wy = alpha_s * a.y() + shared * dy;
    const double wz = alpha_s * a.z() + shared * dz;
    const double gx = shared * a.x() + beta_d * dx;
    const double gy = shared * a.y() + beta_d * dy;
    const double gz = shared * a.z() + beta_d * dz;
    const double isotropic = moment * beta;
    const double xy = -(wx * a.y() + gx * dy);
    const double xz = -(wx * a.z() + gx * dz);
    const double yz = -(wy * a.z() + gy * dz);
    by_x[i] = -(wx * a.x() + gx * dx + isotropic);
    by_x[i + n] = xy;
    by_x[i + 2 * n] = xz;
    by_y[i] = xy;
    by_y[i + n] = -(wy * a.y() + gy * dy + isotropic);
    by_y[i + 2 * n] = yz;
    by_z[i] = xz;
    by_z[i + n] = yz;
    by_z[i + 2 * n] = -(wz * a.z() + gz * dz + isotropic);

    const double turn = moment * alpha;
    const double du = u.x() * dx + u.y() * dy + u.z() * dz;
    const double dv = v.x() * dx + v.y() * dy + v.z() * dz;
    by_first[i] = turn * u.x() + wx * du;
    by_first[i + n] = turn * u.y() + wy * du;
    by_first[i + 2 * n] = turn * u.z() + wz * du;
    by_second[i] = turn * v.x() + wx * dv;
    by_second[i + n] = turn * v.y() + wy * dv;
    by_second[i + 2 * n] = turn * v.z() + wz * dv;
  }
}

}  // namespace gastronaut::magnetics

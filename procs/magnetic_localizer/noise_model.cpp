#include "magnetic_localizer/noise_model.hpp"

namespace gastronaut::magnetics {
namespace {
double square(double x) { return x * x; }
}  // namespace

NoiseModel::NoiseModel(const SensorArray& array, const HallArrayConfiguration& configuration)
    : array_(array),
      constant_variance_(square(configuration.noise) + square(configuration.offset_std)),
      gain_variance_(square(configuration.gain_std)),
      alignment_variance_(square(configuration.alignment_std)) {}

void NoiseModel::covariance(const CleanReading& reading, const Eigen::VectorXd& field,
                            SensorMatrices& covariance) const {
  const Eigen::Index n = array_.num_sensors;
  for (auto& entry : covariance) entry.resize(n);
  const double* const b = field.data();
  const double* const usable = reading.usable.data();
  const double* const removal = reading.variance.data();
  std::array<const double*, 9> r{};
  for (std::size_t k = 0; k < 9; ++k) r[k] = array_.response[k].data();
  std::array<double*, 6> v{};
  for (std::size_t k = 0; k < 6; ++k) v[k] = covariance[k].data();
  const double constant = constant_variance_;
  const double gain = gain_variance_;
  const double alignment = alignment_variance_;
#pragma GCC ivdep
  for (Eigen::Index i = 0; i < n; ++i) {
    const double bx = b[i];
    const double by = b[i + n];
    const double bz = b[i + 2 * n];
    const double along0 = r[0][i] * bx + r[1][i] * by + r[2][i] * bz;
    const double along1 = r[3][i] * bx + r[4][i] * by + r[5][i] * bz;
    const double along2 = r[6][i] * bx + r[7][i] * by + r[8][i] * bz;
    const double c0x = by * r[2][i] - bz * r[1][i];
    const double c0y = bz * r[0][i] - bx * r[2][i];
    const double c0z = bx * r[1][i] - by * r[0][i];
    const double c1x = by * r[5][i] - bz * r[4][i];
    const double c1y = bz * r[3][i] - bx * r[5][i];
    const double c1z = bx * r[4][i] - by * r[3][i];
    const double c2x = by * r[8][i] - bz * r[7][i];
    const double c2y = bz * r[6][i] - bx * r[8][i];
    const double c2z = bx * r[7][i] - by * r[6][i];
    const double m0 = usable[i];
    const double m1 = usable[i + n];
    const double m2 = usable[i + 2 * n];
    v[0][i] = 1 - m0 +
              m0 * (constant + removal[i] + gain * along0 * along0 +
                    alignment * (c0x * c0x + c0y * c0y + c0z * c0z));
    v[3][i] = 1 - m1 +
              m1 * (constant + removal[i + n] + gain * along1 * along1 +
                    alignment * (c1x * c1x + c1y * c1y + c1z * c1z));
    v[5][i] = 1 - m2 +
              m2 * (constant + removal[i + 2 * n] + gain * along2 * along2 +
                    alignment * (c2x * c2x + c2y * c2y + c2z * c2z));
    v[1][i] = m0 * m1 * alignment * (c0x * c1x + c0y * c1y + c0z * c1z);
    v[2][i] = m0 * m2 * alignment * (c0x * c2x + c0y * c2y + c0z * c2z);
    v[4][i] = m1 * m2 * alignment * (c1x * c2x + c1y * c2y + c1z * c2z);
  }
}

FieldInformation::FieldInformation(Eigen::Index num_sensors) {
  for (auto& entry : matrix) entry.setZero(num_sensors);
  vector.setZero(3 * num_sensors);
  scalar.setZero(num_sensors);
}

void inform(const SensorArray& array, const CleanReading& reading, const SensorMatrices& covariance,
            FieldInformation& information) {
  const Eigen::Index n = array.num_sensors;
  const double* const z = reading.value.data();
  const double* const usable = reading.usable.data();
  std::array<const double*, 9> r{};
  for (std::size_t k = 0; k < 9; ++k) r[k] = array.response[k].data();
  std::array<const double*, 6> v{};
  std::array<double*, 6> g{};
  for (std::size_t k = 0; k < 6; ++k) {
    v[k] = covariance[k].data();
    g[k] = information.matrix[k].data();
  }
  double* const h = information.vector.data();
  double* const c = information.scalar.data();
#pragma GCC ivdep
  for (Eigen::Index i = 0; i < n; ++i) {
    // V^-1 by cofactors; rows and columns of unusable channels are taken out.
    const double k00 = v[3][i] * v[5][i] - v[4][i] * v[4][i];
    const double k01 = v[2][i] * v[4][i] - v[1][i] * v[5][i];
    const double k02 = v[1][i] * v[4][i] - v[2][i] * v[3][i];
    const double k11 = v[0][i] * v[5][i] - v[2][i] * v[2][i];
    const double k12 = v[1][i] * v[2][i] - v[0][i] * v[4][i];
    const double k22 = v[0][i] * v[3][i] - v[1][i] * v[1][i];
    const double inverse = 1 / (v[0][i] * k00 + v[1][i] * k01 + v[2][i] * k02);
    const double m0 = usable[i];
    const double m1 = usable[i + n];
    const double m2 = usable[i + 2 * n];
    const double w00 = m0 * inverse * k00;
    const double w01 = m0 * m1 * inverse * k01;
    const double w02 = m0 * m2 * inverse * k02;
    const double w11 = m1 * inverse * k11;
    const double w12 = m1 * m2 * inverse * k12;
    const double w22 = m2 * inverse * k22;
    const double y0 = w00 * z[i] + w01 * z[i + n] + w02 * z[i + 2 * n];
    const double y1 = w01 * z[i] + w11 * z[i + n] + w12 * z[i + 2 * n];
    const double y2 = w02 * z[i] + w12 * z[i + n] + w22 * z[i + 2 * n];
    c[i] = z[i] * y0 + z[i + n] * y1 + z[i + 2 * n] * y2;
    h[i] = r[0][i] * y0 + r[3][i] * y1 + r[6][i] * y2;
    h[i + n] = r[1][i] * y0 + r[4][i] * y1 + r[7][i] * y2;
    h[i + 2 * n] = r[2][i] * y0 + r[5][i] * y1 + r[8][i] * y2;
    const double q0x = w00 * r[0][i] + w01 * r[3][i] + w02 * r[6][i];
    const double q0y = w00 * r[1][i] + w01 * r[4][i] + w02 * r[7][i];
    const double q0z = w00 * r[2][i] + w01 * r[5][i] + w02 * r[8][i];
    const double q1x = w01 * r[0][i] + w11 * r[3][i] + w12 * r[6][i];
    const double q1y = w01 * r[1][i] + w11 * r[4][i] + w12 * r[7][i];
    const double q1z = w01 * r[2][i] + w11 * r[5][i] + w12 * r[8][i];
    const double q2x = w02 * r[0][i] + w12 * r[3][i] + w22 * r[6][i];
    const double q2y = w02 * r[1][i] + w12 * r[4][i] + w22 * r[7][i];
    const double q2z = w02 * r[2][i] + w12 * r[5][i] + w22 * r[8][i];
    g[0][i] = r[0][i] * q0x + r[3][i] * q1x + r[6][i] * q2x;
    g[1][i] = r[0][i] * q0y + r[3][i] * q1y + r[6][i] * q2y;
    g[2][i] = r[0][i] * q0z + r[3][i] * q1z + r[6][i] * q2z;
    g[3][i] = r[1][i] * q0y + r[4][i] * q1y + r[7][i] * q2y;
    g[4][i] = r[1][i] * q0z + r[4][i] * q1z + r[7][i] * q2z;
    g[5][i] = r[2][i] * q0z + r[5][i] * q1z + r[8][i] * q2z;
  }
}

void apply_information(const SensorMatrices& g, const double* in, double* out) {
  const Eigen::Index n = g[0].size();
  const double* const xx = g[0].data();
  const double* const xy = g[1].data();
  const double* const xz = g[2].data();
  const double* const yy = g[3].data();
  const double* const yz = g[4].data();
  const double* const zz = g[5].data();
#pragma GCC ivdep
  for (Eigen::Index i = 0; i < n; ++i) {
    const double x = in[i];
    const double y = in[i + n];
    const double z = in[i + 2 * n];
    out[i] = xx[i] * x + xy[i] * y + xz[i] * z;
    out[i + n] = xy[i] * x + yy[i] * y + yz[i] * z;
    out[i + 2 * n] = xz[i] * x + yz[i] * y + zz[i] * z;
  }
}

void sensor_misfits(const FieldInformation& information, const Eigen::VectorXd& field,
                    Eigen::VectorXd& misfits) {
  const Eigen::Index n = information.scalar.size();
  misfits.resize(n);
  const SensorMatrices& g = information.matrix;
  const double* const h = information.vector.data();
  const double* const b = field.data();
  for (Eigen::Index i = 0; i < n; ++i) {
    const double x = b[i];
    const double y = b[i + n];
    const double z = b[i + 2 * n];
    const double misfit =
        information.scalar[i] - x * (2 * h[i] - g[0][i] * x - 2 * (g[1][i] * y + g[2][i] * z)) -
        y * (2 * h[i + n] - g[3][i] * y - 2 * g[4][i] * z) - z * (2 * h[i + 2 * n] - g[5][i] * z);
    misfits[i] = misfit < 0 ? 0 : misfit;  // rounding of a perfect match
  }
}

void sum_up(const FieldInformation& information, const Eigen::VectorXd& field,
            Eigen::Matrix3d& matrix, Eigen::Vector3d& vector) {
  const Eigen::Index n = information.scalar.size();
  const SensorMatrices& g = information.matrix;
  matrix << g[0].sum(), g[1].sum(), g[2].sum(),  //
      g[1].sum(), g[3].sum(), g[4].sum(),        //
      g[2].sum(), g[4].sum(), g[5].sum();
  constexpr std::size_t kEntry[3][3] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};
  for (std::size_t k = 0; k < 3; ++k) {
    vector[static_cast<Eigen::Index>(k)] =
        information.vector.segment(static_cast<Eigen::Index>(k) * n, n).sum() -
        g[kEntry[k][0]].dot(field.segment(0, n)) - g[kEntry[k][1]].dot(field.segment(n, n)) -
        g[kEntry[k][2]].dot(field.segment(2 * n, n));
  }
}

Eigen::VectorXd measured_field(const SensorArray& array, const CleanReading& reading) {
  const Eigen::Index n = array.num_sensors;
  Eigen::VectorXd field = Eigen::VectorXd::Zero(3 * n);
  for (Eigen::Index s = 0; s < n; ++s) {
    for (Eigen::Index axis = 0; axis < array.num_axes; ++axis) {
      const Eigen::Index c = array.channel(s, axis);
      if (reading.usable[c] == 0) continue;
      const auto row = static_cast<std::size_t>(3 * axis);
      const Eigen::Vector3d direction(array.response[row][s], array.response[row + 1][s],
                                      array.response[row + 2][s]);
      const Eigen::Vector3d part = reading.value[c] / direction.squaredNorm() * direction;
      for (Eigen::Index k = 0; k < 3; ++k) field[k * n + s] += part[k];
    }
  }
  return field;
}

}  // namespace gastronaut::magnetics

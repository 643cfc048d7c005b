#include "calibrate/magnet_pose_fit.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>

#include "calibrate/robust_weight.hpp"
#include "magnetics/axial_magnet.hpp"
#include "magnetics/dipole.hpp"

namespace gastronaut {
namespace {

constexpr int kPoseSize = 5;  // position, then the axis in its tangent plane
constexpr int kUnknowns = kPoseSize + 3;
constexpr int kFewestChannels = 12;  // half as many again as there are unknowns
constexpr int kMostIterations = 60;
constexpr double kFirstDamping = 1e-3;
constexpr double kHopelessDamping = 1e9;
constexpr double kConvergedDecrease = 1e-9;  // relative, of the cost
constexpr double kNearestStart = 0.02;       // metres below the array: nearer it sees no pattern
constexpr double kGridStep = 0.03;           // metres; the fit converges from further than half
constexpr double kLargestStep = 0.03;        // metres; the field changes its shape beyond

using Vector8d = Eigen::Matrix<double, kUnknowns, 1>;
using Matrix8d = Eigen::Matrix<double, kUnknowns, kUnknowns>;

}  // namespace

MagnetPoseFitter::MagnetPoseFitter(const RigConfiguration& rig)
    : lowest_sensor_(std::numeric_limits<double>::infinity()),
      coil_matrix_(rig.coils.tesla_per_ampere),
      moment_(rig.magnet.moment),
      octupole_ratio_(octupole_ratio(rig.magnet.shape())),
      sigma_(std::hypot(rig.hall_array.noise, rig.hall_array.offset_std)),
      search_(rig.magnetic_localizer) {
  for (const HallSensorConfiguration& sensor : rig.hall_array.resolved_sensors()) {
    for (Eigen::Index axis = 0; axis < sensor.response.rows(); ++axis) {
      channels_.push_back({static_cast<Eigen::Index>(positions_.size()), sensor.response.row(axis),
                           sensor.offset[static_cast<std::size_t>(axis)]});
    }
    positions_.push_back(sensor.position);
    lowest_sensor_ = std::min(lowest_sensor_, sensor.position.z());
  }
}

Eigen::VectorXd MagnetPoseFitter::without_coils(const CalibrationReading& reading) const {
  Eigen::VectorXd field = reading.field;
  if (coil_matrix_.size() != 0) field -= coil_matrix_ * reading.currents;
  for (std::size_t c = 0; c < channels_.size(); ++c) {
    field(static_cast<Eigen::Index>(c)) -= channels_[c].offset;
  }
  return field;
}

MagnetPose MagnetPoseFitter::search(const Eigen::VectorXd& field, const std::vector<bool>& usable,
                                    double* residual) const {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& position : positions_) centre += position;
  centre /= static_cast<double>(positions_.size());

  using Vector6 = Eigen::Matrix<double, 6, 1>;  // moment in A m^2, background in units of kUnit
  using Matrix6 = Eigen::Matrix<double, 6, 6>;
  constexpr double kUnit = 1e-4;  // tesla: makes both halves of the normal matrix alike in size
  MagnetPose best;
  *residual = std::numeric_limits<double>::infinity();
  const int half = static_cast<int>(std::ceil(search_.search_half_width / kGridStep));
  const int deep = static_cast<int>(std::ceil(search_.search_depth / kGridStep));
  for (int iz = 0; iz < deep; ++iz) {
    for (int iy = -half; iy <= half; ++iy) {
      for (int ix = -half; ix <= half; ++ix) {
        const Eigen::Vector3d place = centre + Eigen::Vector3d(ix * kGridStep, iy * kGridStep,
                                                               -kNearestStart - iz * kGridStep);
        Matrix6 normal = Matrix6::Zero();
        Vector6 right = Vector6::Zero();
        double total = 0;
        for (std::size_t c = 0; c < channels_.size(); ++c) {
          if (!usable[c]) continue;
          const Channel& channel = channels_[c];
          Vector6 row;
          row.head<3>() =
              dipole_field_by_moment(positions_[static_cast<std::size_t>(channel.sensor)] - place)
                  .transpose() *
              channel.response.transpose();
          row.tail<3>() = channel.response.transpose() * kUnit;
          const double value = field(static_cast<Eigen::Index>(c));
          normal += row * row.transpose();
          right += row * value;
          total += value * value;
        }
        const Vector6 solution = normal.ldlt().solve(right);
        const double left = total - right.dot(solution);
        if (left < *residual && solution.head<3>().norm() > 0) {
          *residual = left;
          best = {place, solution.head<3>().normalized()};
        }
      }
    }
  }
  return best;
}

MagnetPoseFitter::Cost MagnetPoseFitter::cost(const Eigen::VectorXd& field,
                                              const std::vector<bool>& usable,
                                              const MagnetPose& pose,
                                              const Eigen::Vector3d& background) const {
  Cost cost;
  Eigen::Index sensor = -1;
  Eigen::Vector3d expected;
  for (std::size_t c = 0; c < channels_.size(); ++c) {
    if (!usable[c]) continue;
    if (channels_[c].sensor != sensor) {
      sensor = channels_[c].sensor;
      expected = background +
                 axial_magnet_field(positions_[static_cast<std::size_t>(sensor)] - pose.position,
                                    moment_ * pose.axis, octupole_ratio_);
    }
    const double residual =
        (field(static_cast<Eigen::Index>(c)) - channels_[c].response.dot(expected)) / sigma_;
    cost.value += robust_loss(residual);
    if (std::abs(residual) > kRobustKnee) {
      ++cost.outliers;
    } else {
      cost.squares += residual * residual;
      ++cost.used;
    }
  }
  cost.value += (background / search_.background_std).squaredNorm();
  return cost;
}

std::optional<MagnetPoseFit> MagnetPoseFitter::fit(const CalibrationReading& reading,
                                                   const std::optional<MagnetPose>& start) const {
  const std::vector<bool>& usable = reading.usable;
  const auto num_usable = std::count(usable.begin(), usable.end(), true);
  if (num_usable < kFewestChannels) return std::nullopt;
  const Eigen::VectorXd field = without_coils(reading);
  double ignored = 0;
  MagnetPose pose = start ? *start : search(field, usable, &ignored);
  Eigen::Vector3d background = Eigen::Vector3d::Zero();
  Cost current = cost(field, usable, pose, background);
  double damping = kFirstDamping;
  bool converged = false;
  for (int iteration = 0; iteration < kMostIterations && !converged; ++iteration) {
    const Eigen::Matrix<double, 3, 2> tangent = perpendicular_basis(pose.axis);
    Matrix8d normal = Matrix8d::Zero();
    Vector8d right = Vector8d::Zero();
    Eigen::Index sensor = -1;
    AxialMagnetDerivatives magnet;
    for (std::size_t c = 0; c < channels_.size(); ++c) {
      if (!usable[c]) continue;
      const Channel& channel = channels_[c];
      if (channel.sensor != sensor) {
        sensor = channel.sensor;
        magnet =
            axial_magnet_derivatives(positions_[static_cast<std::size_t>(sensor)] - pose.position,
                                     moment_ * pose.axis, octupole_ratio_);
      }
      Vector8d row;
      row.head<3>() = -magnet.by_offset.transpose() * channel.response.transpose();
      row.segment<2>(3) =
          moment_ * (magnet.by_moment * tangent).transpose() * channel.response.transpose();
      row.tail<3>() = channel.response.transpose();
      row /= sigma_;
      const double residual =
          (field(static_cast<Eigen::Index>(c)) - channel.response.dot(magnet.field + background)) /
          sigma_;
      const double weight = robust_weight(residual);
      normal += weight * row * row.transpose();
      right += weight * residual * row;
    }
    const double prior = 1 / (search_.background_std * search_.background_std);
    normal.diagonal().tail<3>().array() += prior;
    right.tail<3>() -= prior * background;
    while (true) {
      Matrix8d damped = normal;
      damped.diagonal() *= 1 + damping;
      Vector8d step = damped.ldlt().solve(right);
      const double length = step.head<3>().norm();
      if (length > kLargestStep) step *= kLargestStep / length;
      const MagnetPose moved{pose.position + step.head<3>(),
                             (pose.axis + tangent * step.segment<2>(3)).normalized()};
      const Eigen::Vector3d moved_background = background + step.tail<3>();
      const Cost next = cost(field, usable, moved, moved_background);
      if (next.value <= current.value && moved.position.z() < lowest_sensor_) {
        converged = current.value - next.value <= kConvergedDecrease * current.value;
        pose = moved;
        background = moved_background;
        current = next;
        damping /= 10;
        break;
      }
      damping *= 10;
      if (damping > kHopelessDamping) {
        converged = true;
        break;
      }
    }
  }
  if (!converged || current.used < kFewestChannels) return std::nullopt;
  double strongest = 0;
  for (const Eigen::Vector3d& position : positions_) {
    strongest = std::max(
        strongest,
        axial_magnet_field(position - pose.position, moment_ * pose.axis, octupole_ratio_).norm());
  }
  return MagnetPoseFit{pose,
                       background,
                       sigma_ * std::sqrt(current.squares / current.used),
                       current.value / static_cast<double>(num_usable),
                       strongest,
                       current.outliers / static_cast<double>(num_usable)};
}

double MagnetPoseFitter::explained_by_magnet(const Eigen::VectorXd& field) const {
  const std::vector<bool> all(channels_.size(), true);
  double residual = 0;
  search(field, all, &residual);
  Eigen::MatrixXd responses(field.size(), 3);
  for (std::size_t c = 0; c < channels_.size(); ++c) {
    responses.row(static_cast<Eigen::Index>(c)) = channels_[c].response;
  }
  const Eigen::VectorXd uniform =
      responses * (responses.transpose() * responses).ldlt().solve(responses.transpose() * field);
  return 1 - residual / (field - uniform).squaredNorm();
}

}  // namespace gastronaut

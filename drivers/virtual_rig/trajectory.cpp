#include "virtual_rig/trajectory.hpp"

#include <array>
#include <cmath>
#include <numbers>

#include "numerics/counter_random.hpp"
#include "virtual_rig/random_streams.hpp"

namespace gastronaut {
namespace {

constexpr double kTurn = 2 * std::numbers::pi;
// The part of the axis that a tour may use, and how far it may leave its line across.
constexpr double kMiddle = 0.48;
constexpr double kFurthest = 0.31;
constexpr double kSideways = 0.006;     // metres
constexpr double kStandoffSwing = 0.2;  // relative
constexpr double kRoomBehind = 0.015;   // metres that stay free behind the lens, folds included
constexpr double kSoftness = 0.006;     // metres over which that takes effect
constexpr int kMostLaps = 200;
constexpr int kLengthSteps = 4000;
constexpr std::array<double, 2> kTiltRates = {3, 5};  // swings in a period of a light calibration
constexpr double kRollRate = 2;
constexpr double kPauseFraction = 0.5;  // of the dwell in which the magnet rests

double soft_maximum(double a, double b) { return (a + b + std::hypot(a - b, kSoftness)) / 2; }

double smooth_step(double t) { return t * t * t * (t * (t * 6 - 15) + 10); }

}  // namespace

Trajectory::Trajectory(const TrajectoryConfiguration& trajectory, const Centreline& centreline,
                       const SE3& camera_T_magnet, std::uint64_t seed)
    : trajectory_(trajectory),
      centreline_(centreline),
      magnet_T_camera_(camera_T_magnet.inverse()),
      seed_(seed) {
  if (trajectory_.kind != TrajectoryKind::kTour && trajectory_.kind != TrajectoryKind::kStatic) {
    return;
  }
  // As few laps as are long enough, then everything a little smaller until the length is right.
  while (tour_length() < trajectory_.path_length) {
    if (++laps_ > kMostLaps) {
      throw ConfigurationError(
          "trajectory.path_length: " + std::to_string(trajectory_.path_length) +
          " m cannot be travelled in this organ");
    }
  }
  double low = 0;
  double high = 1;
  constexpr int kHalvings = 40;
  for (int i = 0; i < kHalvings; ++i) {
    scale_ = (low + high) / 2;
    (tour_length() < trajectory_.path_length ? low : high) = scale_;
  }
}

double Trajectory::tour_length() const {
  const double end = trajectory_.returns ? 1 : 0.5 / laps_ + (laps_ - 1.0) / laps_;
  double length = 0;
  Eigen::Vector3d last = tour(0).translation;
  for (int i = 1; i <= kLengthSteps; ++i) {
    const Eigen::Vector3d next = tour(end * i / kLengthSteps).translation;
    length += (next - last).norm();
    last = next;
  }
  return length;
}

std::optional<SE3> Trajectory::pose(double time) const {
  switch (trajectory_.kind) {
    case TrajectoryKind::kTour: {
      const double periods = time / trajectory_.period;
      if (trajectory_.returns) return tour(periods - std::floor(periods));
      // To the far end, and back the same way.
      const double end = (laps_ - 0.5) / laps_;
      const double half = periods - 2 * std::floor(periods / 2);
      return tour(end * (half <= 1 ? half : 2 - half));
    }
    case TrajectoryKind::kStatic:
      return tour(0);
    case TrajectoryKind::kArrayCalibration:
      return array_calibration(time);
    case TrajectoryKind::kLightCalibration:
      return light_calibration(time / trajectory_.period);
    case TrajectoryKind::kAbsent:
      break;
  }
  return std::nullopt;
}

// A closed curve in its phase 0..1: along the axis and back, the view swinging about the axis, the
// lens at its distance from the wall that it looks at.
SE3 Trajectory::tour(double phase) const {
  const CounterRandom random(seed_, stream_id(RandomStream::kTrajectory));
  const auto wave = [&](std::uint64_t number, double frequency) {
    return std::sin(kTurn * (frequency * phase + random.uniform(number)));
  };
  const double swings = trajectory_.swings;
  const double fraction = kMiddle - scale_ * kFurthest * std::cos(kTurn * laps_ * phase);
  const double angle = trajectory_.view_angle + scale_ * trajectory_.swing * wave(0, swings);
  const double tilt = scale_ * trajectory_.tilt * wave(1, swings);
  const double roll = scale_ * trajectory_.roll * wave(2, swings);
  const double standoff =
      trajectory_.standoff * (1 + scale_ * kStandoffSwing * wave(3, 2 * swings));

  const Centreline::Frame axis = centreline_.frame(fraction);
  const Eigen::Vector3d across = axis.direction(angle);
  const Eigen::Vector3d along_wall = axis.tangent.cross(across);
  // Metres from the axis towards the wall that is looked at; never too near to the one behind.
  const double radius = centreline_.radius(fraction, angle);
  const double room = std::max(0.0, centreline_.radius(fraction, angle + kTurn / 2) - kRoomBehind);
  const double towards = soft_maximum(radius - standoff * std::cos(tilt), -room);

  SE3 rig_T_camera;
  rig_T_camera.translation =
      axis.centre + towards * across + scale_ * kSideways * wave(4, 2 * swings) * along_wall;
  Eigen::Matrix3d rotation;
  rotation.col(2) = std::cos(tilt) * across + std::sin(tilt) * axis.tangent;
  const Eigen::Vector3d forwards = std::cos(tilt) * axis.tangent - std::sin(tilt) * across;
  rotation.col(0) = std::cos(roll) * along_wall + std::sin(roll) * forwards;
  rotation.col(1) = rotation.col(2).cross(rotation.col(0));
  rig_T_camera.rotation = Eigen::Quaterniond(rotation).normalized();
  return rig_T_camera;
}

// Equal times in equal ratios of distance, for light falls with its square; the view swings across
// both ways at rates that do not repeat with the distance.
SE3 Trajectory::light_calibration(double phase) const {
  const CounterRandom random(seed_, stream_id(RandomStream::kTrajectory));
  const auto wave = [&](std::uint64_t number, double frequency) {
    return std::sin(kTurn * (frequency * phase + random.uniform(number)));
  };
  const double distance = trajectory_.nearest * std::pow(trajectory_.furthest / trajectory_.nearest,
                                                         0.5 - 0.5 * std::cos(kTurn * phase));
  const double roll = trajectory_.roll * wave(2, kRollRate);
  const Centreline::Frame card = centreline_.frame(0.5);
  const Eigen::Vector2d tilt =
      trajectory_.tilt * Eigen::Vector2d(wave(0, kTiltRates[0]), wave(1, kTiltRates[1]));
  const Eigen::Vector3d view =
      (-card.up + tilt.x() * card.tangent + tilt.y() * card.side).normalized();
  const Eigen::Vector3d along =
      (std::cos(roll) * card.tangent + std::sin(roll) * card.side).cross(view).normalized();
  SE3 rig_T_camera;
  rig_T_camera.translation = card.centre - distance * view;
  Eigen::Matrix3d rotation;
  rotation << along, view.cross(along), view;
  rig_T_camera.rotation = Eigen::Quaterniond(rotation).normalized();
  return rig_T_camera;
}

// Pose of the magnet at place `index` of the walk.
SE3 Trajectory::calibration_place(std::uint64_t index) const {
  const CounterRandom random(seed_, stream_id(RandomStream::kTrajectory, index));
  SE3 rig_T_magnet;
  for (int i = 0; i < 3; ++i) {
    rig_T_magnet.translation[i] =
        trajectory_.box_centre[i] +
        trajectory_.box_half_size[i] * (2 * random.uniform(static_cast<std::uint64_t>(i)) - 1);
  }
  const Eigen::Vector4d q(random.normal(3), random.normal(4), random.normal(5), random.normal(6));
  rig_T_magnet.rotation = Eigen::Quaterniond(q).normalized();
  return rig_T_magnet;
}

SE3 Trajectory::array_calibration(double time) const {
  const double dwells = std::max(0.0, time / trajectory_.dwell);
  const auto index = static_cast<std::uint64_t>(dwells);
  const double moving =
      (dwells - static_cast<double>(index) - kPauseFraction) / (1 - kPauseFraction);
  const SE3 from = calibration_place(index);
  const SE3 to = calibration_place(index + 1);
  const double fraction = smooth_step(std::max(0.0, moving));
  SE3 rig_T_magnet;
  rig_T_magnet.translation = from.translation + fraction * (to.translation - from.translation);
  rig_T_magnet.rotation = from.rotation.slerp(fraction, to.rotation);
  return rig_T_magnet * magnet_T_camera_;
}

}  // namespace gastronaut

#include "unit/procs/calibrate/hand_eye_simulation.hpp"

#include <array>
#include <cmath>

#include "numerics/counter_random.hpp"

namespace gastronaut {
namespace {

// Draws one after the other.
class Dice {
 public:
  Dice(std::uint64_t seed, std::uint64_t stream) : random_(seed, stream) {}
  Eigen::Vector3d normal(double sigma) {
    Eigen::Vector3d v;
    for (int i = 0; i < 3; ++i) v(i) = sigma * random_.normal(drawn_++);
    return v;
  }
  double uniform(double low, double high) { return low + (high - low) * random_.uniform(drawn_++); }

 private:
  CounterRandom random_;
  std::uint64_t drawn_ = 0;
};

MagneticFix fix_at(const HandEye& truth, const SE3& map_T_camera, double time) {
  const Eigen::Quaterniond rig_R_camera = truth.rig_T_map.rotation * map_T_camera.rotation;
  MagneticFix fix;
  fix.time = time;
  fix.position =
      truth.rig_T_map * (truth.scale * map_T_camera.translation) + rig_R_camera * truth.centre;
  fix.axis = rig_R_camera * truth.axis;
  return fix;
}

void add_noise(MagneticFix& fix, const HandEyeErrors& errors, Dice& dice) {
  fix.position += dice.normal(errors.magnet_position);
  // A turn about the axis itself changes nothing.
  fix.axis = so3_exp(dice.normal(errors.magnet_axis)) * fix.axis;
  fix.covariance.setZero();
  fix.covariance.diagonal().head<3>().setConstant(std::pow(errors.magnet_position, 2));
  fix.covariance.diagonal().tail<2>().setConstant(std::pow(errors.magnet_axis, 2));
}

// A smooth random vector field of unit rms a component.
class Field {
 public:
  explicit Field(Dice& dice) {
    for (int i = 0; i < kWaves; ++i) {
      // So alike are the errors of fixes that an array 85 mm away makes with gains and alignments
      // wrong in each sensor by itself: 0.7 and 0.3 over 20 and 40 mm, 0.6 over half a radian.
      directions_.push_back(dice.normal(40));
      axis_directions_.push_back(dice.normal(2));
      amplitudes_.push_back(dice.normal(std::sqrt(2.0 / kWaves)));
      phases_.push_back(dice.uniform(0, 2 * std::numbers::pi));
    }
  }
  Eigen::Vector3d at(const MagneticFix& fix) const {
    Eigen::Vector3d value = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < kWaves; ++i) {
      value += amplitudes_[i] * std::sin(directions_[i].dot(fix.position) +
                                         axis_directions_[i].dot(fix.axis) + phases_[i]);
    }
    return value;
  }

 private:
  static constexpr int kWaves = 12;
  std::vector<Eigen::Vector3d> directions_;
  std::vector<Eigen::Vector3d> axis_directions_;
  std::vector<Eigen::Vector3d> amplitudes_;
  std::vector<double> phases_;
};

}  // namespace

HandEye true_hand_eye() {
  HandEye truth;
  truth.centre = {0.8e-3, -0.5e-3, -9e-3};
  truth.axis = Eigen::Vector3d(-0.3, 0.2, 0.9).normalized();
  truth.rig_T_map = {so3_exp({0.4, -1.1, 2.0}), Eigen::Vector3d(0.02, -0.01, -0.03)};
  truth.scale = 1.04;
  return truth;
}

HandEye wrong_hand_eye() {
  HandEye wrong;
  wrong.centre = {0.01, 0.015, 0.005};
  wrong.axis = Eigen::Vector3d(0.6, 0.2, -0.8).normalized();
  return wrong;
}

std::vector<SE3> random_poses(int count, std::uint64_t seed) {
  Dice dice(seed, 1);
  std::vector<SE3> poses;
  for (int i = 0; i < count; ++i) {
    SE3 pose;
    for (int axis = 0; axis < 3; ++axis) pose.translation(axis) = dice.uniform(-0.03, 0.03);
    pose.rotation = so3_exp(dice.uniform(0, 60 * kOneDegree) * dice.normal(1).normalized());
    poses.push_back(pose);
  }
  return poses;
}

SimulatedHandEye stop_and_go(const HandEye& truth, const std::vector<SE3>& poses,
                             const HandEyeErrors& errors, std::uint64_t seed) {
  Dice dice(seed, 2);
  SimulatedHandEye run;
  constexpr double kStand = 0.1;  // seconds
  for (std::size_t i = 0; i < poses.size(); ++i) {
    const auto time = static_cast<double>(i);
    MagneticFix fix = fix_at(truth, poses[i], time + kStand / 2);
    add_noise(fix, errors, dice);
    run.fixes.push_back(fix);
    const SE3 seen{poses[i].rotation * so3_exp(dice.normal(errors.camera_rotation)),
                   poses[i].translation + dice.normal(errors.camera_position)};
    run.frames.push_back({time, seen});
    run.frames.push_back({time + kStand, seen});
  }
  return run;
}

SimulatedHandEye swinging(const HandEye& truth, double duration, const HandEyeErrors& errors,
                          const SharedErrors& shared, std::uint64_t seed) {
  Dice dice(seed, 3);
  std::array<Eigen::Vector3d, 2> phases;
  for (Eigen::Vector3d& phase : phases) {
    for (int i = 0; i < 3; ++i) phase(i) = dice.uniform(0, 2 * std::numbers::pi);
  }
  const auto pose_at = [&](double time) {
    const Eigen::Array3d turn_rates(0.9, 1.3, 0.7);  // radians a second
    const Eigen::Array3d rates(0.5, 0.8, 0.6);
    const Eigen::Vector3d turn = 0.6 * (turn_rates * time + phases[0].array()).sin().matrix();
    const Eigen::Vector3d place = 0.02 * (rates * time + phases[1].array()).sin().matrix();
    return SE3{so3_exp(turn), place};
  };
  SimulatedHandEye run;
  constexpr double kFramePeriod = 0.05;
  const double kept = std::exp(-kFramePeriod / 4);  // of the drift, from frame to frame
  Eigen::Vector3d moved = dice.normal(shared.visual_position);
  Eigen::Vector3d turned = dice.normal(shared.visual_rotation);
  for (double time = 0; time < duration; time += kFramePeriod) {
    SE3 pose = pose_at(time);
    pose.translation += moved;
    pose.rotation = so3_exp(turned) * pose.rotation;
    run.frames.push_back({time, pose});
    moved = kept * moved + dice.normal(std::sqrt(1 - kept * kept) * shared.visual_position);
    turned = kept * turned + dice.normal(std::sqrt(1 - kept * kept) * shared.visual_rotation);
  }
  const Field position_error(dice);
  const Field axis_error(dice);
  for (double time = 0; time < duration; time += 0.01) {
    MagneticFix fix = fix_at(truth, pose_at(time + truth.time_offset), time);
    const Eigen::Vector3d off = shared.magnetic_position * position_error.at(fix);
    fix.axis = so3_exp(shared.magnetic_axis * axis_error.at(fix)) * fix.axis;
    fix.position += off;
    add_noise(fix, errors, dice);
    run.fixes.push_back(fix);
  }
  return run;
}

Vector5d hand_eye_error(const HandEye& estimate, const HandEye& truth) {
  Vector5d error;
  error << estimate.centre - truth.centre,
      perpendicular_basis(estimate.axis).transpose() * truth.axis.cross(estimate.axis);
  return error;
}

}  // namespace gastronaut

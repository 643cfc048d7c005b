// A capsule on a smooth path, its magnet located and its camera tracked with errors that are just
// those that BeliefModel speaks of: what a filter of that model can be measured against.
#pragma once

#include <Eigen/Cholesky>
#include <cmath>
#include <functional>
#include <vector>

#include "numerics/counter_random.hpp"
#include "sensor_fusion/switching_filter.hpp"

namespace gastronaut::fusion::test {

inline constexpr double kMagneticInterval = 0.01;  // seconds
inline constexpr int kMagneticPerVisual = 5;       // 20 Hz

struct Scenario {
  std::uint64_t seed = 1;
  double seconds = 10;
  double pace = 1;   // 0: at rest
  double swing = 1;  // of the rotations
  double map_scale = 1.03;
  double time_offset = 0;  // a fix stamped t is of t + time_offset
  double position_std = 3e-4;
  double axis_std = 5e-3;
  SE3 camera_T_magnet{so3_exp({0.05, -0.1, 0}), {5e-4, -3e-4, -9e-3}};  // the true one
  // Failures: may change a measurement at `time`; false: it is not sent.
  std::function<bool(double time, MagneticMeasurement&)> magnetic;
  std::function<bool(double time, VisualMeasurement&)> visual;
};

inline SE3 true_pose(double time, const Scenario& scenario) {
  const double t = scenario.pace * time;
  const Eigen::Vector3d position(0.02 * std::sin(0.7 * t), 0.015 * std::sin(0.9 * t + 1),
                                 0.06 + 0.01 * std::sin(0.5 * t + 2));
  const Eigen::Vector3d turned(0.5 * std::sin(0.9 * t + 0.3), 0.4 * std::sin(1.1 * t + 1.2),
                               0.6 * std::sin(0.7 * t + 0.5));
  return {so3_exp({1, 0.5, 0}) * so3_exp(scenario.swing * turned), position};
}

// What the filter knows of the scenario.
inline FilterOptions options_for(const Scenario& scenario) {
  FilterOptions options;
  options.camera_T_magnet = scenario.camera_T_magnet;
  options.model.angular_acceleration_std = 0.5;  // the path's
  options.particles = 200;
  return options;
}

struct Step {
  double time = 0;
  bool is_visual = false;
  SE3 truth;
  double true_scale = 1;  // of vision's map, drift included
  FusedState state;
};

class Draw {
 public:
  Draw(std::uint64_t seed, std::uint64_t stream) : random_(seed, stream) {}
  double operator()() { return random_.normal(index_++); }
  Eigen::Vector3d vector() { return {(*this)(), (*this)(), (*this)()}; }
  Vector6d of(const Matrix6d& covariance) {
    Vector6d white;
    white << vector(), vector();
    return Eigen::LLT<Matrix6d>(covariance).matrixL() * white;
  }

 private:
  CounterRandom random_;
  std::uint64_t index_ = 0;
};

inline std::vector<Step> run(const Scenario& scenario, const FilterOptions& options,
                             SwitchingFilter& filter) {
  const BeliefModel& model = options.model;
  Draw magnetic(scenario.seed, 1);
  Draw visual(scenario.seed, 2);
  const double share = model.bias_share;
  Eigen::Vector3d position_bias = std::sqrt(share) * scenario.position_std * magnetic.vector();
  Eigen::Vector3d axis_bias = std::sqrt(share) * scenario.axis_std * magnetic.vector();
  const auto white = [&](double distance) {
    return swinging_noise(model.visual_position_std * distance, model.visual_rotation_std,
                          distance);
  };
  SE3 map_T_camera{so3_exp({0.2, -0.4, 1}), {0.01, 0.02, -0.01}};
  double log_scale = std::log(scenario.map_scale);
  SE3 before = true_pose(0, scenario);

  std::vector<Step> steps;
  const int count = static_cast<int>(scenario.seconds / kMagneticInterval);
  for (int i = 0; i < count; ++i) {
    const double t = i * kMagneticInterval;
    const auto utime = static_cast<std::int64_t>(i) * 10'000 + 1'000'000;
    const SE3 truth = true_pose(t, scenario);
    const SE3 then = true_pose(t + scenario.time_offset, scenario);

    const double speed =
        (then.translation -
         true_pose(t + scenario.time_offset - kMagneticInterval, scenario).translation)
            .norm() /
        kMagneticInterval;
    const double keeps =
        std::exp(-kMagneticInterval * (speed / model.bias_length + 1 / model.bias_time));
    const double fresh = std::sqrt(share * (1 - keeps * keeps));
    position_bias = keeps * position_bias + fresh * scenario.position_std * magnetic.vector();
    axis_bias = keeps * axis_bias + fresh * scenario.axis_std * magnetic.vector();
    MagneticMeasurement fix;
    fix.utime = utime;
    fix.is_usable = true;
    fix.fix.position = then * scenario.camera_T_magnet.translation + position_bias +
                       std::sqrt(1 - share) * scenario.position_std * magnetic.vector();
    const Eigen::Vector3d axis =
        then.rotation * (scenario.camera_T_magnet.rotation * Eigen::Vector3d::UnitZ());
    fix.fix.axis =
        so3_exp(axis_bias + std::sqrt(1 - share) * scenario.axis_std * magnetic.vector()) * axis;
    fix.fix.covariance.setZero();
    fix.fix.covariance.diagonal() << Eigen::Vector3d::Constant(std::pow(scenario.position_std, 2)),
        Eigen::Vector2d::Constant(std::pow(scenario.axis_std, 2));
    if (!scenario.magnetic || scenario.magnetic(t, fix)) {
      steps.push_back({t, false, truth, std::exp(log_scale), filter.update(fix)});
    }

    if (i % kMagneticPerVisual != 0) continue;
    SE3 moved = before.inverse() * truth;
    before = truth;
    const double path = moved.translation.norm() / model.working_distance +
                        angle_between(moved.rotation, Eigen::Quaterniond::Identity());
    moved.translation /= std::exp(log_scale);
    if (path > 0) {
      const double distance = model.working_distance;
      const Vector6d drift = visual.of(
          path * swinging_noise(model.drift_position * distance, model.drift_rotation, distance));
      moved.translation += moved.rotation * drift.head<3>() / std::exp(log_scale);
      moved.rotation = moved.rotation * so3_exp(drift.tail<3>());
      log_scale += std::sqrt(path) * model.drift_scale * visual();
    }
    map_T_camera = map_T_camera * moved;
    const Vector6d noise = visual.of(white(model.working_distance));
    VisualMeasurement frame;
    frame.utime = utime;
    frame.is_usable = true;
    frame.map_T_camera = {
        (map_T_camera.rotation * so3_exp(noise.tail<3>())).normalized(),
        map_T_camera.translation + map_T_camera.rotation * noise.head<3>() / std::exp(log_scale)};
    frame.covariance = white(model.working_distance);
    if (!scenario.visual || scenario.visual(t, frame)) {
      steps.push_back({t, true, truth, std::exp(log_scale), filter.update(frame)});
    }
  }
  return steps;
}

inline std::vector<Step> run(const Scenario& scenario) {
  const FilterOptions options = options_for(scenario);
  SwitchingFilter filter(options);
  return run(scenario, options, filter);
}

inline double position_error(const Step& step) {
  return (step.state.rig_T_camera.translation - step.truth.translation).norm();
}
inline double angle_error(const Step& step) {
  return angle_between(step.state.rig_T_camera.rotation, step.truth.rotation);
}
// Normalised estimation error squared, of the 6 numbers of the pose.
inline double nees(const Step& step) {
  Vector6d error;
  const SE3& pose = step.state.rig_T_camera;
  error << step.truth.translation - pose.translation,
      so3_log(pose.rotation.conjugate() * step.truth.rotation);
  return error.dot(step.state.covariance.ldlt().solve(error));
}

}  // namespace gastronaut::fusion::test

#include "sensor_fusion/switching_filter.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <stdexcept>

namespace gastronaut::fusion {
namespace {

constexpr double kMicrosecond = 1e-6;
constexpr double kStartConfidence = 0.9;
constexpr double kLongestGap = 60;        // seconds: after a longer one nothing more is forgotten
constexpr double kLongestStep = 0.25;     // seconds of prediction at once
constexpr double kUsualInterval = 0.05;   // seconds, until a sensor's own is known
constexpr double kLongestInterval = 0.2;  // no sensor is expected to be slower
constexpr double kIntervalMemory = 0.1;
constexpr double kLeastSilence = 0.1;  // seconds
constexpr int kMostSilences = 50;      // counted at once: by then the sensor has failed anyway
// Histories that differ little are many, and cost time: the likeliest are kept, of at least two.
constexpr std::size_t kMostBeliefs = 12;
constexpr double kLeastHistory = 1e-6;  // weight
constexpr double kOpenRoll = 0.5;       // radians, one sigma: no Gaussian is that wide
// Where nothing is known of the capsule it is within this of the array's centre.
constexpr double kSearchBox = 0.3;  // metres
constexpr double kFarthest = 100;   // metres: nothing is that far, nor that uncertain
// How fast a sensor's noise is learnt, a measurement; outliers count as so many sigmas at most.
constexpr double kLearningRate[kNumSensors] = {0.002, 0.01};
// What the check of the calibration starts from, one sigma.
constexpr double kUnknownPosition = 3e-3;    // metres
constexpr double kUnknownAxis = 0.05;        // radians
constexpr double kUnknownTimeOffset = 1e-2;  // seconds
// Vision may drift so many times faster than it seems before the calibration is blamed.
constexpr double kPatienceWithDrift = 4;
constexpr double kScatterLearningRate = 0.01;
constexpr double kLongestScatter = 0.05;  // seconds: later fixes differ by motion
constexpr double kFastest = 0.2;          // m/s, of a capsule
constexpr double kLeastScatter = 0.02;
constexpr double kInnovationMemory = 0.02;
constexpr double kDriftLearningRate = 0.15;
constexpr double kMostDriftInflation = 400;
constexpr double kMoved = 20;       // sigmas of vision's noise
constexpr double kLongestPath = 4;  // of vision between two frames, working distances
constexpr double kMostSurprise = 4;
constexpr double kMostInflation = 25;

bool is_covariance(const Eigen::MatrixXd& matrix) {
  return matrix.allFinite() && matrix.isApprox(matrix.transpose(), 1e-6) &&
         Eigen::LLT<Eigen::MatrixXd>(matrix).info() == Eigen::Success;
}

bool is_good(const MagneticFix& fix) {
  constexpr double kUnit = 1e-3;
  return fix.position.norm() < kFarthest && std::abs(fix.axis.norm() - 1) < kUnit &&
         is_covariance(fix.covariance) &&
         fix.covariance.diagonal().maxCoeff() < kFarthest * kFarthest;
}

bool is_good(const SE3& pose) {
  constexpr double kUnit = 1e-3;
  return pose.translation.norm() < kFarthest && std::abs(pose.rotation.norm() - 1) < kUnit;
}

// The part of a symmetric matrix that is not negative.
Matrix6d positive_part(const Matrix6d& matrix) {
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(matrix);
  return solver.eigenvectors() * solver.eigenvalues().cwiseMax(0).asDiagonal() *
         solver.eigenvectors().transpose();
}

// Of vision, from frame to frame.
Matrix6d white_noise(const BeliefModel& model) {
  return swinging_noise(model.visual_position_std * model.working_distance,
                        model.visual_rotation_std, model.working_distance);
}

// In the worst direction, rad^2.
double worst_rotation_variance(const FusedState& state) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> rotation(
      state.covariance.bottomRightCorner<3, 3>(), Eigen::EigenvaluesOnly);
  return rotation.eigenvalues()(2);
}

// Density of what a failed sensor gives, which is anything: positions within the search box, axes
// on the sphere, rotations of any kind. The same whatever is believed of the pose, so that where
// little is known one reading does not decide, and where much is wrongly taken for known it does
// not last.
double log_density_of_anything(Sensor sensor, Eigen::Index size) {
  const double position = -3 * std::log(kSearchBox);
  const double axis = -std::log(4 * std::numbers::pi);
  const double rotation = -std::log(8 * std::numbers::pi * std::numbers::pi);
  if (sensor == Sensor::kMagnetic) return size == 3 ? position : position + axis;
  return size == 3 ? rotation : position + rotation;
}

}  // namespace

SwitchingFilter::SwitchingFilter(const FilterOptions& options)
    : options_(options),
      particles_(options.particles, options.alpha_memory, options.seed, kStartConfidence) {
  if (options.rolls < 1 || !(options.unusable_share > 0) || !(options.unusable_share < 1)) {
    throw std::invalid_argument(
        "sensor_fusion: rolls must be positive, unusable_share within (0, 1)");
  }
}

// A fix of the magnet: what all beliefs expected of it says how likely each is.
FusedState SwitchingFilter::update(const MagneticMeasurement& measurement) {
  const bool is_usable = measurement.is_usable && is_good(measurement.fix);
  advance(measurement.utime);
  note_arrival(Sensor::kMagnetic, measurement.utime);
  notice_silence(Sensor::kVisual, measurement.utime);
  if (!is_usable) {
    last_fix_.reset();
    count_unusable(Sensor::kMagnetic, measurement.is_usable ? "corrupt" : measurement.cause);
    return state(measurement.utime);
  }
  if (!follows_the_last(measurement)) {
    last_fix_ = measurement.fix;
    last_fix_utime_ = measurement.utime;
    count_unusable(Sensor::kMagnetic, "jumps");
    return state(measurement.utime);
  }
  MagneticFix fix = measurement.fix;
  fix.axis.normalize();
  fix.covariance *= record(Sensor::kMagnetic).inflation;
  learn_scatter(measurement.utime, measurement.fix);
  const double bias_share = std::max(options_.model.bias_share, 1 - scatter_);
  Eigen::Matrix<double, 6, 5> to_rig = Eigen::Matrix<double, 6, 5>::Zero();
  to_rig.topLeftCorner<3, 3>().setIdentity();
  to_rig.bottomRightCorner<3, 2>() = perpendicular_basis(fix.axis);
  bias_covariance_ = bias_share * to_rig * fix.covariance * to_rig.transpose();
  if (histories_.empty()) {
    begin(fix);
    return state(measurement.utime);
  }
  const bool with_axis = !options_.position_and_rotation_only || !has_begun_;
  assimilate(Sensor::kMagnetic, [&](const CapsuleBelief& belief) {
    return belief.observe_magnet(fix, scatter_, with_axis);
  });
  const SensorRecord& magnetic = record(Sensor::kMagnetic);
  if (magnetic.health.is_used) clock_.add_fix(measurement.utime, fix.position);
  if (magnetic.refused_for > options_.magnetic_patience) begin_again(fix);
  return state(measurement.utime);
}

// A pose of vision: in a map whose place in the rig each belief has its own idea of.
FusedState SwitchingFilter::update(const VisualMeasurement& measurement) {
  const bool is_usable = measurement.is_usable && is_good(measurement.map_T_camera);
  advance(measurement.utime);
  note_arrival(Sensor::kVisual, measurement.utime);
  notice_silence(Sensor::kMagnetic, measurement.utime);
  meet_map(measurement);
  if (!is_usable) {
    count_unusable(Sensor::kVisual, measurement.is_usable ? "corrupt" : measurement.cause);
  } else if (!histories_.empty()) {
    if (!likeliest().has_map) {
      establish_maps(measurement);
    } else if (!has_begun_ && !has_moved(measurement)) {
      return state(measurement.utime);
    } else {
      let_maps_drift(measurement);
      const Matrix6d noise = visual_noise(measurement);
      const bool rotation_only = options_.position_and_rotation_only && has_begun_;
      assimilate(Sensor::kVisual, [&](const CapsuleBelief& belief) {
        return belief.observe_camera(measurement.map_T_camera, noise, rotation_only);
      });
    }
    watch_clock(measurement);
    last_map_T_camera_ = measurement.map_T_camera;
    last_frame_utime_ = measurement.utime;
    if (!measurement.is_degraded && is_covariance(measurement.covariance)) {
      well_held_ = measurement.covariance;
    }
    if (record(Sensor::kVisual).refused_for > options_.visual_patience) {
      for_each_belief([](CapsuleBelief& belief) { belief.has_map = false; });
      record(Sensor::kVisual).refused_for = 0;
    }
  }
  const FusedState result = state(measurement.utime);
  told_scale_ = result.depth_scale;
  return result;
}

void SwitchingFilter::advance(std::int64_t utime) {
  const double elapsed = std::min(static_cast<double>(utime - utime_) * kMicrosecond, kLongestGap);
  utime_ = utime;
  if (!(elapsed > 0)) return;
  const int steps = static_cast<int>(std::ceil(elapsed / kLongestStep));
  for (int i = 0; i < steps; ++i) {
    const auto predict = [&](CapsuleBelief& belief) {
      belief.predict(elapsed / steps, options_.model, bias_covariance_);
    };
    for_each_belief(predict);
    if (check_) predict(*check_);
  }
}

void SwitchingFilter::note_arrival(Sensor sensor, std::int64_t utime) {
  SensorRecord& arrived = record(sensor);
  if (arrived.last) {
    const double interval = static_cast<double>(utime - *arrived.last) * kMicrosecond;
    arrived.since_last = interval;
    if (arrived.interval == 0) arrived.interval = std::min(interval, kLongestInterval);
    if (interval < kLongestInterval) {
      arrived.interval += kIntervalMemory * (interval - arrived.interval);
    }
  }
  arrived.last = utime;
  arrived.silence_noticed = utime;
}

// Of a sensor that says nothing every measurement that it owes is an unusable one.
void SwitchingFilter::notice_silence(Sensor sensor, std::int64_t utime) {
  SensorRecord& quiet = record(sensor);
  if (!quiet.last) quiet.last = quiet.silence_noticed = utime;
  const double interval = quiet.interval > 0 ? quiet.interval : kUsualInterval;
  const double silent_for = static_cast<double>(utime - *quiet.last) * kMicrosecond;
  if (silent_for < std::max(kLeastSilence, options_.silence * interval)) return;
  const auto step = static_cast<std::int64_t>(interval / kMicrosecond) + 1;
  for (int i = 0; i < kMostSilences && quiet.silence_noticed + step <= utime; ++i) {
    quiet.silence_noticed += step;
    count_unusable(sensor, "silent");
  }
  quiet.silence_noticed = std::max(quiet.silence_noticed, utime - step);
}

void SwitchingFilter::count_unusable(Sensor sensor, const std::string& cause) {
  SensorRecord& unusable = record(sensor);
  unusable.told_cause = cause;
  unusable.refused_for =
      std::max(0.0, unusable.refused_for - std::min(unusable.since_last, kLongestInterval));
  const std::size_t histories = std::max<std::size_t>(histories_.size(), 1);
  const double nominal = particles_.update(
      static_cast<std::size_t>(sensor),
      std::vector<SwitchLikelihood>(histories, {std::log(options_.unusable_share), 0.0}));
  // The pose is the same whether or not the sensor has failed: one history.
  std::vector<int> number;
  for (std::size_t i = 0; i < histories; ++i) number.insert(number.end(), 2, static_cast<int>(i));
  particles_.renumber(number);
  particles_.resample();
  set_health(sensor, nominal);
  unusable.health.is_used = false;
}

void SwitchingFilter::begin(const MagneticFix& fix) {
  CapsuleBelief belief;
  belief.magnet_position = options_.camera_T_magnet.translation;
  belief.magnet_axis = options_.camera_T_magnet.rotation * Eigen::Vector3d::UnitZ();
  belief.time_offset = options_.time_offset;
  ErrorMatrix& c = belief.covariance;
  const auto square = [](double value) { return value * value; };
  c.diagonal().segment<3>(kVelocity).setConstant(square(options_.start_velocity_std));
  c.diagonal().segment<3>(kTurn).setConstant(square(options_.start_turn_std));
  c(kMapScale, kMapScale) = square(options_.depth_scale_std);
  c.block<6, 6>(kPositionBias, kPositionBias) = bias_covariance_;
  c.diagonal().segment<3>(kMagnetPosition).setConstant(square(options_.hand_eye_position_std));
  c.diagonal().segment<2>(kMagnetAxis).setConstant(square(options_.hand_eye_axis_std));
  c(kTimeOffset, kTimeOffset) = square(options_.time_offset_std);

  belief.position = fix.position;
  belief.rig_R_camera =
      Eigen::Quaterniond::FromTwoVectors(belief.magnet_axis, fix.axis).normalized();
  const Eigen::Matrix3d camera_R_rig = belief.rig_R_camera.conjugate().toRotationMatrix();
  Eigen::Matrix<double, 6, 5> to_error = Eigen::Matrix<double, 6, 5>::Zero();
  to_error.topLeftCorner<3, 3>().setIdentity();
  to_error.bottomRightCorner<3, 2>() = camera_R_rig * perpendicular_basis(fix.axis);
  c.block<6, 6>(kPosition, kPosition) = to_error * fix.covariance * to_error.transpose();
  // The pose is wrong by what the fix is, its bias included: in the other direction.
  Matrix6d bias_to_error = -Matrix6d::Identity();
  bias_to_error.bottomRightCorner<3, 3>() = -camera_R_rig;
  const Matrix6d shared = bias_to_error * bias_covariance_;
  c.block<6, 6>(kPosition, kPositionBias) = shared;
  c.block<6, 6>(kPositionBias, kPosition) = shared.transpose();
  begin_rolls(belief);
}

void SwitchingFilter::begin_rolls(const CapsuleBelief& belief) {
  histories_ = {BeliefMixture::of_all_rolls(belief, options_.rolls)};
  particles_.spread(histories_.size());
  has_begun_ = false;
}

// The magnet is absolute: where it has contradicted for long, the pose was wrong.
void SwitchingFilter::begin_again(const MagneticFix& fix) {
  check_.reset();
  for (SensorRecord& sensor : sensors_) {
    sensor.refused_for = 0;
    sensor.inflation = 1;
  }
  drift_inflation_ = 1;
  recent_innovation_.setZero();
  begin(fix);
}

void SwitchingFilter::meet_map(const VisualMeasurement& measurement) {
  if (map_version_ == measurement.map_version) return;
  // A step up: visual_slam has taken over the scale that it was told. A step down: it has begun
  // again from nothing.
  check_.reset();
  const double before = scale_of_map_;
  if (map_version_) scale_of_map_ = measurement.map_version > *map_version_ ? told_scale_ : 1;
  for_each_belief([&](CapsuleBelief& belief) {
    belief.has_map = false;
    belief.map_scale *= before / scale_of_map_;
  });
  map_version_ = measurement.map_version;
  last_map_T_camera_.reset();
  well_held_.reset();
  clock_.forget_path();
}

void SwitchingFilter::establish_maps(const VisualMeasurement& measurement) {
  if (has_begun_) {
    const FusedState now = state(measurement.utime);
    if (worst_rotation_variance(now) > kOpenRoll * kOpenRoll) {
      begin_rolls(CapsuleBelief(likeliest()));
    }
  }
  const Matrix6d noise = white_noise(options_.model);
  for_each_belief(
      [&](CapsuleBelief& belief) { belief.establish_map(measurement.map_T_camera, noise); });
  check_.reset();
}

// The likeliest belief, but with a calibration that is hardly known.
void SwitchingFilter::begin_check() {
  check_ = likeliest();
  check_->learns_calibration = true;
  ErrorMatrix& c = check_->covariance;
  c.middleRows<kCalibrationSize>(kCalibration).setZero();
  c.middleCols<kCalibrationSize>(kCalibration).setZero();
  c.diagonal().segment<3>(kMagnetPosition).setConstant(kUnknownPosition * kUnknownPosition);
  c.diagonal().segment<2>(kMagnetAxis).setConstant(kUnknownAxis * kUnknownAxis);
  c(kTimeOffset, kTimeOffset) = kUnknownTimeOffset * kUnknownTimeOffset;
}

// Since the last frame that was made use of. As long as the roll is open others are not: the model
// expects motion, and would take the noise of a resting camera for it, and for evidence.
bool SwitchingFilter::has_moved(const VisualMeasurement& measurement) const {
  if (!last_map_T_camera_) return true;
  const BeliefModel& model = options_.model;
  const SE3 moved = last_map_T_camera_->inverse() * measurement.map_T_camera;
  return likeliest().map_scale * moved.translation.norm() >
             kMoved * model.visual_position_std * model.working_distance ||
         angle_between(moved.rotation, Eigen::Quaterniond::Identity()) >
             kMoved * model.visual_rotation_std;
}

void SwitchingFilter::watch_clock(const VisualMeasurement& measurement) {
  if (!last_map_T_camera_ || !record(Sensor::kVisual).health.is_used || measurement.is_degraded) {
    clock_.forget_path();
    return;
  }
  const CapsuleBelief& belief = likeliest();
  const SE3 from = *last_map_T_camera_;
  const SE3 to = measurement.map_T_camera;
  const Eigen::Vector3d moved = belief.map_scale * (to.translation - from.translation) +
                                to.rotation * belief.magnet_position -
                                from.rotation * belief.magnet_position;
  clock_.add_path(last_frame_utime_, measurement.utime, moved, belief.rig_T_map.rotation);
}

// Along the path since the last frame.
void SwitchingFilter::let_maps_drift(const VisualMeasurement& measurement) {
  if (!last_map_T_camera_) return;
  const BeliefModel& model = options_.model;
  const SE3 moved = last_map_T_camera_->inverse() * measurement.map_T_camera;
  const double inflation = record(Sensor::kVisual).inflation * drift_inflation_;
  const double turned = angle_between(moved.rotation, Eigen::Quaterniond::Identity());
  const Matrix6d noise = swinging_noise(model.drift_position * model.working_distance,
                                        model.drift_rotation, model.working_distance);
  const auto drift = [&](CapsuleBelief& belief, double factor) {
    // A longer one is a jump, not drift: whatever it is, the belief must survive it.
    const double path =
        std::min(kLongestPath,
                 belief.map_scale * moved.translation.norm() / model.working_distance + turned);
    belief.let_map_drift(factor * path * noise,
                         factor * path * model.drift_scale * model.drift_scale);
  };
  for_each_belief([&](CapsuleBelief& belief) { drift(belief, inflation); });
  if (check_) drift(*check_, kPatienceWithDrift * inflation);
}

// Vision's noise from frame to frame; where it says that it is held worse than it was, that too.
Matrix6d SwitchingFilter::visual_noise(const VisualMeasurement& measurement) const {
  Matrix6d noise = record(Sensor::kVisual).inflation * white_noise(options_.model);
  if (measurement.is_degraded && well_held_ && is_covariance(measurement.covariance)) {
    Vector6d to_metres = Vector6d::Ones();
    to_metres.head<3>().setConstant(likeliest().map_scale);
    noise += to_metres.asDiagonal() * positive_part(measurement.covariance - *well_held_) *
             to_metres.asDiagonal();
  }
  return noise;
}

void SwitchingFilter::assimilate(Sensor sensor, const Observe& observe) {
  std::vector<MixtureGain> gains;
  std::vector<SwitchLikelihood> likelihoods;
  for (const BeliefMixture& history : histories_) {
    gains.push_back(history.weigh(observe));
    const Eigen::Index size = gains.back().gains.front().whitened.size();
    likelihoods.push_back({gains.back().log_density, log_density_of_anything(sensor, size)});
  }
  SensorRecord& used = record(sensor);
  used.told_cause.clear();
  set_health(sensor, particles_.update(static_cast<std::size_t>(sensor), likelihoods));
  used.health.is_used = !failed(sensor);
  if (used.health.is_used) {
    const std::size_t history = likeliest_history();
    learn_noise(sensor, gains[history].gains[histories_[history].likeliest()]);
    used.refused_for = 0;
    if (check_) check_->update(check_->weigh(observe(*check_)));
  } else {
    used.refused_for += std::min(used.since_last, kLongestInterval);
  }
  branch(gains);
}

// A sensor whose innovations are larger than they should be is noisier than it says.
void SwitchingFilter::learn_noise(Sensor sensor, const Gain& gain) {
  if (!std::isfinite(gain.log_density)) return;
  const double surprise =
      std::min(gain.chi2 / static_cast<double>(gain.whitened.size()), kMostSurprise);
  SensorRecord& learnt = record(sensor);
  learnt.inflation = std::clamp(
      learnt.inflation * std::exp(kLearningRate[static_cast<std::size_t>(sensor)] * (surprise - 1)),
      1.0, kMostInflation);
  if (sensor == Sensor::kMagnetic) learn_drift(gain);
}

// Innovations of a filter that models its sensors well are white (Mehra 1970).
void SwitchingFilter::learn_drift(const Gain& magnetic) {
  Eigen::Vector3d innovation = magnetic.whitened.head<3>();
  innovation *= std::min(1.0, kMostSurprise / std::max(innovation.norm(), 1e-9));
  const double likeness = innovation.dot(recent_innovation_) / 3;
  recent_innovation_ += kInnovationMemory * (innovation - recent_innovation_);
  drift_inflation_ = std::clamp(drift_inflation_ * std::exp(kDriftLearningRate * likeness), 1.0,
                                kMostDriftInflation);
}

// A magnet that comes back into reach, or out of a foreign field, is located somewhere else in
// every reading for a while, and is sure of it each time: no capsule is that fast.
bool SwitchingFilter::follows_the_last(const MagneticMeasurement& measurement) const {
  const SensorRecord& magnetic = record(Sensor::kMagnetic);
  if (histories_.empty() || magnetic.since_last > kLongestScatter) return true;
  if (!last_fix_) return false;
  const double elapsed = static_cast<double>(measurement.utime - last_fix_utime_) * kMicrosecond;
  const Eigen::Matrix3d both = measurement.fix.covariance.topLeftCorner<3, 3>() +
                               last_fix_->covariance.topLeftCorner<3, 3>();
  return (measurement.fix.position - last_fix_->position).norm() <
         kFastest * elapsed + kMostSurprise * std::sqrt(both.trace());
}

// Fixes one after the other share their bias: what they differ by, motion apart, is not bias.
void SwitchingFilter::learn_scatter(std::int64_t utime, const MagneticFix& fix) {
  const double elapsed = static_cast<double>(utime - last_fix_utime_) * kMicrosecond;
  if (last_fix_ && !histories_.empty() && elapsed > 0 && elapsed < kLongestScatter) {
    const CapsuleBelief& belief = likeliest();
    Vector5d difference;
    const Eigen::Vector3d turned =
        so3_log(Eigen::Quaterniond::FromTwoVectors(last_fix_->axis, fix.axis)) -
        elapsed * belief.turn;
    difference << fix.position - last_fix_->position - elapsed * belief.velocity,
        perpendicular_basis(fix.axis).transpose() * turned;
    const Matrix5d both = fix.covariance + last_fix_->covariance;
    const double chi2 = difference.dot(both.llt().solve(difference));
    const double share = std::isfinite(chi2) ? std::min(chi2 / 5, kMostSurprise) : 1;
    scatter_ += kScatterLearningRate * (share - scatter_);
    scatter_ = std::max(scatter_, kLeastScatter);
  }
  last_fix_ = fix;
  last_fix_utime_ = utime;
}

std::size_t SwitchingFilter::likeliest_history() const {
  const std::vector<double> weights = particles_.belief_weights(histories_.size());
  return static_cast<std::size_t>(std::max_element(weights.begin(), weights.end()) -
                                  weights.begin());
}

const CapsuleBelief& SwitchingFilter::likeliest() const {
  const BeliefMixture& history = histories_[likeliest_history()];
  return history.beliefs[history.likeliest()];
}

void SwitchingFilter::for_each_belief(const std::function<void(CapsuleBelief&)>& action) {
  for (BeliefMixture& history : histories_) {
    for (CapsuleBelief& belief : history.beliefs) action(belief);
  }
}

std::size_t SwitchingFilter::num_beliefs() const {
  std::size_t count = 0;
  for (const BeliefMixture& history : histories_) count += history.beliefs.size();
  return count;
}

// Each history of switches that particles hold becomes one of its own.
void SwitchingFilter::branch(const std::vector<MixtureGain>& gains) {
  const std::vector<double> weights = particles_.history_weights(histories_.size());
  std::vector<std::size_t> order(weights.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&weights](std::size_t a, std::size_t b) { return weights[a] > weights[b]; });
  std::vector<int> number(weights.size(), -1);
  std::vector<BeliefMixture> next;
  std::size_t beliefs = 0;
  for (const std::size_t history : order) {
    if (!next.empty() && weights[history] < kLeastHistory) break;
    if (next.size() >= 2 && beliefs >= kMostBeliefs) break;
    number[history] = static_cast<int>(next.size());
    next.push_back(histories_[history / 2]);
    if (history % 2 == 1) next.back().update(gains[history / 2]);
    beliefs += next.back().beliefs.size();
  }
  histories_ = std::move(next);
  particles_.renumber(number);
  particles_.resample();
}

void SwitchingFilter::set_health(Sensor sensor, double nominal) {
  SensorRecord& changed = record(sensor);
  changed.health.nominal = nominal;
  changed.health.alpha = particles_.confidence(static_cast<std::size_t>(sensor));
  changed.health.cause.clear();
  if (!failed(sensor)) return;
  changed.health.cause =
      changed.told_cause.empty() ? "contradicts the other sensor" : changed.told_cause;
}

bool SwitchingFilter::failed(Sensor sensor) const {
  return record(sensor).health.nominal < options_.failure_threshold;
}

FusedState SwitchingFilter::state(std::int64_t utime) {
  FusedState result;
  result.utime = utime;
  for (std::size_t i = 0; i < kNumSensors; ++i) result.sensors[i] = sensors_[i].health;
  if (histories_.empty()) {
    result.covariance.diagonal() << Eigen::Vector3d::Constant(kSearchBox * kSearchBox),
        Eigen::Vector3d::Constant(std::numbers::pi * std::numbers::pi / 3);
    return result;
  }
  // Mean and covariance of the mixture, on the tangent of its likeliest part.
  const std::vector<double> history_weights = particles_.belief_weights(histories_.size());
  const SE3 centre = likeliest().rig_T_camera();
  std::vector<Vector6d> offsets;
  Vector6d mean = Vector6d::Zero();
  double log_scale = 0;
  const auto for_each = [&](const auto& action) {
    for (std::size_t i = 0; i < histories_.size(); ++i) {
      const BeliefMixture& history = histories_[i];
      for (std::size_t k = 0; k < history.beliefs.size(); ++k) {
        action(history.beliefs[k], history_weights[i] * history.weights[k]);
      }
    }
  };
  for_each([&](const CapsuleBelief& belief, double weight) {
    const SE3 pose = belief.rig_T_camera();
    Vector6d offset;
    offset << pose.translation - centre.translation,
        so3_log(centre.rotation.conjugate() * pose.rotation);
    mean += weight * offset;
    offsets.push_back(offset);
    result.velocity += weight * belief.camera_velocity();
    result.angular_velocity += weight * (pose.rotation.conjugate() * belief.turn);
    log_scale += weight * std::log(belief.map_scale);
  });
  auto next_offset = offsets.begin();
  for_each([&](const CapsuleBelief& belief, double weight) {
    const Vector6d offset = *next_offset++ - mean;
    result.covariance += weight * (belief.pose_covariance() + offset * offset.transpose());
  });
  result.rig_T_camera = {(centre.rotation * so3_exp(mean.tail<3>())).normalized(),
                         centre.translation + mean.head<3>()};
  result.depth_scale = scale_of_map_ * std::exp(log_scale);

  if (worst_rotation_variance(result) < options_.known_roll * options_.known_roll) {
    has_begun_ = true;
  }
  const bool magnetic_failed = failed(Sensor::kMagnetic);
  const bool visual_failed = failed(Sensor::kVisual);
  if (magnetic_failed && visual_failed) {
    result.status = FusionStatus::kPredicting;
  } else if (magnetic_failed || visual_failed) {
    result.status = FusionStatus::kDegraded;
  } else {
    result.status = has_begun_ ? FusionStatus::kNominal : FusionStatus::kInitialising;
  }
  if (has_begun_ && !check_ && likeliest().has_map) begin_check();
  return result;
}

CalibrationCheck SwitchingFilter::check_calibration() const {
  CalibrationCheck check;
  check.clock = clock_.estimate();
  if (!check_) return check;
  const Eigen::Vector3d axis = options_.camera_T_magnet.rotation * Eigen::Vector3d::UnitZ();
  check.magnet_position = check_->magnet_position;
  check.axis_change =
      std::atan2(axis.cross(check_->magnet_axis).norm(), axis.dot(check_->magnet_axis));

  Vector5d change;
  change << check_->magnet_position - options_.camera_T_magnet.translation,
      perpendicular_basis(axis).transpose() *
          so3_log(Eigen::Quaterniond::FromTwoVectors(axis, check_->magnet_axis));
  Matrix5d covariance = check_->covariance.block<5, 5>(kMagnetPosition, kMagnetPosition);
  covariance.diagonal().head<3>().array() +=
      options_.hand_eye_position_std * options_.hand_eye_position_std;
  covariance.diagonal().tail<2>().array() +=
      options_.hand_eye_axis_std * options_.hand_eye_axis_std;
  check.hand_eye_chi2 = change.dot(covariance.ldlt().solve(change));
  return check;
}

}  // namespace gastronaut::fusion

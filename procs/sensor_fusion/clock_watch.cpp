#include "sensor_fusion/clock_watch.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "geometry/se3.hpp"

namespace gastronaut::fusion {
namespace {

constexpr double kMicrosecond = 1e-6;
constexpr double kLongestPath = 0.3;  // seconds between two frames: no straight line beyond
constexpr double kSlow = 2;           // seconds: what changes slower takes no part
constexpr double kMemory = 60;        // seconds
constexpr double kCorrelation = 0.3;  // seconds for which errors stay alike
constexpr double kLeastTime = 5;      // seconds of samples before anything is told
constexpr double kRidge = 1e-9;       // of the largest: directions without motion
constexpr std::size_t kMostFixes = 1000;

}  // namespace

void ClockWatch::add_fix(std::int64_t utime, const Eigen::Vector3d& magnet_position) {
  fixes_.push_back({utime, magnet_position});
  if (fixes_.size() > kMostFixes) fixes_.pop_front();
}

void ClockWatch::add_path(std::int64_t begin_utime, std::int64_t end_utime,
                          const Eigen::Vector3d& displacement,
                          const Eigen::Quaterniond& rig_R_map) {
  const double duration = static_cast<double>(end_utime - begin_utime) * kMicrosecond;
  if (!(duration > 0 && duration < kLongestPath)) {
    forget_path();
    return;
  }
  if (!is_under_way_) rig_R_map_ = rig_R_map;
  const Eigen::Vector3d moved = rig_R_map_ * displacement;
  const Eigen::Vector3d velocity = moved / duration;
  for (; !fixes_.empty() && fixes_.front().utime <= end_utime; fixes_.pop_front()) {
    const Fix& fix = fixes_.front();
    if (fix.utime < begin_utime) continue;
    const double since = static_cast<double>(fix.utime - begin_utime) * kMicrosecond;
    const double interval = static_cast<double>(fix.utime - last_utime_) * kMicrosecond;
    last_utime_ = fix.utime;
    const Eigen::Vector3d place = path_ + since * velocity;
    Sample sample;
    sample << fix.position - place, velocity, place;
    add_sample(std::min(interval, kLongestPath), sample);
  }
  path_ += moved;
}

void ClockWatch::add_sample(double interval, const Sample& sample) {
  if (!is_under_way_) {
    mean_ = sample;
    is_under_way_ = true;
    return;
  }
  mean_ += (1 - std::exp(-interval / kSlow)) * (sample - mean_);
  const Sample change = sample - mean_;
  const Eigen::Vector3d place = change.col(2);
  Eigen::Matrix<double, 3, kUnknowns> effect;
  effect << change.col(1), -skew(place), place;
  const double keeps = std::exp(-interval / kMemory);
  time_ = keeps * time_ + interval;
  normal_ = keeps * normal_ + interval * effect.transpose() * effect;
  product_ = keeps * product_ + interval * effect.transpose() * change.col(0);
  square_ = keeps * square_ + interval * change.col(0).squaredNorm();
}

void ClockWatch::forget_path() {
  fixes_.clear();
  is_under_way_ = false;
  path_.setZero();
}

ClockEstimate ClockWatch::estimate() const {
  const double largest = normal_.diagonal().maxCoeff();
  if (time_ < kLeastTime || !(largest > 0)) return {};
  auto regular = normal_;
  regular.diagonal().array() += kRidge * largest;
  const Eigen::LDLT<decltype(regular)> solver(regular);
  const Eigen::Matrix<double, kUnknowns, 1> solution = solver.solve(product_);
  const double rest = std::max(0.0, square_ - solution.dot(product_)) / (3 * time_);
  const Eigen::Matrix<double, kUnknowns, 1> unit = Eigen::Matrix<double, kUnknowns, 1>::Unit(0);
  const double variance = rest * kCorrelation * solver.solve(unit)(0);
  if (!(variance >= 0)) return {};
  return {solution(0), std::sqrt(variance)};
}

}  // namespace gastronaut::fusion

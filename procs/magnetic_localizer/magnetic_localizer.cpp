#include "magnetic_localizer/magnetic_localizer.hpp"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "magnetic_localizer/full_field.hpp"
#include "magnetic_localizer/second_difference.hpp"

namespace gastronaut::magnetics {
namespace {

// Before the fit a sensor may be off because the magnet has moved since the last fix.
constexpr double kStartingSlack = 10;
// Leaving outliers out may bring others to light.
constexpr int kMostRounds = 5;
// While searching does not help, it is tried again after 1, 2, 4... readings: the last fix stays
// the start of every reading, and the search costs a hundred times as much.
constexpr int kMostPatience = 8;
// chi2_per_dof that chance exceeds once in hundreds of readings, or in a million.
constexpr double kSignificant = 3;
constexpr double kCertain = 5;

// chi2_per_dof has mean 1 and this standard deviation when model and noise explain the reading.
double chi2_spread(int degrees_of_freedom) { return std::sqrt(2.0 / degrees_of_freedom); }

std::unique_ptr<Estimator> make_estimator(const RigConfiguration& configuration,
                                          const SensorArray& array, const MagnetModel& model) {
  const MagneticLocalizerConfiguration& localizer = configuration.magnetic_localizer;
  if (localizer.estimator == MagneticEstimator::kSecondDifference) {
    return std::make_unique<SecondDifference>(array, model, configuration.hall_array,
                                              localizer.background_std);
  }
  return std::make_unique<FullField>(array, model);
}

}  // namespace

MagneticLocalizer::MagneticLocalizer(const RigConfiguration& configuration)
    : limits_(configuration.magnetic_localizer),
      prior_{configuration.magnet.moment,
             limits_.estimate_moment ? configuration.magnet.moment_std : 0, limits_.background_std},
      has_coils_(configuration.coils.tesla_per_ampere.size() > 0),
      array_(configuration.hall_array),
      cleaner_(configuration),
      model_(array_, octupole_ratio(configuration.magnet.shape())),
      noise_(array_, configuration.hall_array),
      search_(array_, configuration),
      estimator_(make_estimator(configuration, array_, model_)),
      information_(array_.num_sensors),
      used_information_(array_.num_sensors) {}

MagneticFix MagneticLocalizer::localize(const HallReading& reading,
                                        const std::optional<Eigen::VectorXd>& currents) {
  const bool coil_field_left_in = has_coils_ && !currents;
  cleaner_.clean(reading, has_coils_ ? currents : std::nullopt, reading_);
  const double num_channels = static_cast<double>(array_.num_sensors * array_.num_axes);
  if (reading_.num_usable < limits_.min_channel_fraction * num_channels) {
    return unknown_pose(FixStatus::kSaturated);
  }
  std::optional<Solution> solution;
  if (last_) solution = explain(*last_);
  if (!solution || !explains(*solution)) {
    if (background_explains()) return unknown_pose(FixStatus::kTooFar);
    if (!last_ || readings_until_search_-- <= 0) {
      for (const MagnetState& start : search()) {
        const Solution found = explain(start);
        // A mono-axial plane cannot tell above from below; the magnet is below.
        if (found.fit.state.position.z() > array_.position[2].maxCoeff()) continue;
        if (!solution || found.cost < solution->cost) solution = found;
      }
      // Once more, with the noise weighed for the state found.
      if (solution && solution->fit.converged) solution = explain(solution->fit.state);
      readings_until_search_ = patience_;
      patience_ = std::min(2 * patience_, kMostPatience);
    }
  }
  if (!solution) return unknown_pose(FixStatus::kNoFix);
  MagneticFix fix = judge(*solution, coil_field_left_in);
  if (fix.status == FixStatus::kOk) {
    last_ = fix.state;
    readings_until_search_ = 0;
    patience_ = 1;
  }
  return fix;
}

MagneticFix MagneticLocalizer::judge(const Solution& solution, bool coil_field_left_in) {
  const bool foreign = !explains(solution) && solution.chi2_per_dof > limits_.interference_chi2;
  const FixStatus failure = coil_field_left_in ? FixStatus::kNoCurrents
                            : foreign          ? FixStatus::kInterference
                                               : FixStatus::kNoFix;
  if (!solution.fit.converged) return unknown_pose(failure);
  MagneticFix fix;
  fix.state = solution.fit.state;
  fix.residual_rms = solution.residual_rms;
  fix.chi2_per_dof = solution.chi2_per_dof;
  fix.num_channels_used = solution.num_channels_used;
  fix.covariance = solution.fit.covariance.topLeftCorner<5, 5>();
  if (fix.chi2_per_dof > 1 + kSignificant * chi2_spread(solution.degrees_of_freedom)) {
    fix.covariance *= fix.chi2_per_dof;
  }
  if (coil_field_left_in || !explains(solution)) {
    // How far a field that is not in the model pulls the fit, no residual can tell.
    fix.covariance += unknown_pose(failure).covariance;
    fix.status = coil_field_left_in ? FixStatus::kNoCurrents : FixStatus::kInterference;
    return fix;
  }
  const double position_std = std::sqrt(fix.covariance.topLeftCorner<3, 3>().trace());
  const double axis_std = std::sqrt(fix.covariance.bottomRightCorner<2, 2>().trace());
  const bool weak = position_std > limits_.max_position_std || axis_std > limits_.max_axis_std;
  fix.status = weak ? FixStatus::kTooFar : FixStatus::kOk;
  return fix;
}

MagneticFix MagneticLocalizer::unknown_pose(FixStatus status) const {
  MagneticFix fix;
  fix.status = status;
  fix.state.position = array_.centre() - Eigen::Vector3d(0, 0, limits_.search_depth / 2);
  fix.state.moment = prior_.moment;
  const double half_depth = limits_.search_depth / 2;
  fix.covariance.diagonal() << limits_.search_half_width * limits_.search_half_width,
      limits_.search_half_width * limits_.search_half_width, half_depth * half_depth,
      std::numbers::pi * std::numbers::pi, std::numbers::pi * std::numbers::pi;
  return fix;
}

bool MagneticLocalizer::explains(const Solution& solution) const {
  return solution.fit.converged && solution.chi2_per_dof <= limits_.interference_chi2 &&
         solution.num_outliers <=
             limits_.max_outlier_fraction * static_cast<double>(array_.num_sensors);
}

MagneticLocalizer::Solution MagneticLocalizer::explain(const MagnetState& start) {
  Solution solution;
  solution.fit.state = start;
  model_.field(start, field_);
  weigh(reading_, covariance_, information_);
  solution.num_outliers = find_outliers(kStartingSlack * limits_.outlier_sigmas, outliers_);
  for (int round = 1;; ++round) {
    solution.num_channels_used = leave_out(outliers_);
    solution.degrees_of_freedom = estimator_->num_observations() - estimator_->num_fitted();
    if (solution.degrees_of_freedom <= 0) {
      solution.fit.converged = false;
      return solution;
    }
    solution.fit = fit_magnet(*estimator_, prior_, solution.fit.state);
    solution.chi2_per_dof = solution.fit.misfit / solution.degrees_of_freedom;
    if (!solution.fit.converged) return solution;
    model_.field(solution.fit.state, field_);
    if (!estimator_->fits_background()) {
      solution.fit.state.background += uniform_field(*fitted_, field_);
      model_.field(solution.fit.state, field_);
    }
    const int num_outliers = find_outliers(limits_.outlier_sigmas, new_outliers_);
    if (new_outliers_ == outliers_ || round == kMostRounds) break;
    outliers_.swap(new_outliers_);
    solution.num_outliers = num_outliers;
    weigh(reading_, covariance_, information_);
  }
  solution.residual_rms = residual_rms();
  const double limit = limits_.outlier_sigmas * limits_.outlier_sigmas;
  solution.cost = misfits_.array().min(limit).sum();
  return solution;
}

std::vector<MagnetState> MagneticLocalizer::search() {
  field_ = measured_field(array_, reading_);
  weigh(reading_, covariance_, information_);
  return search_.candidates(information_);
}

bool MagneticLocalizer::background_explains() {
  field_.setZero(3 * array_.num_sensors);
  weigh(reading_, covariance_, information_);
  const Eigen::Vector3d background = uniform_field(information_, field_);
  for (Eigen::Index k = 0; k < 3; ++k) {
    field_.segment(k * array_.num_sensors, array_.num_sensors).setConstant(background[k]);
  }
  weigh(reading_, covariance_, information_);
  sensor_misfits(information_, field_, misfits_);
  const int degrees_of_freedom = reading_.num_usable - 3;
  return misfits_.sum() < degrees_of_freedom * (1 + kCertain * chi2_spread(degrees_of_freedom));
}

void MagneticLocalizer::weigh(const CleanReading& reading, SensorMatrices& covariance,
                              FieldInformation& information) const {
  noise_.covariance(reading, field_, covariance);
  inform(array_, reading, covariance, information);
}

int MagneticLocalizer::leave_out(const std::vector<char>& outliers) {
  if (std::find(outliers.begin(), outliers.end(), 1) == outliers.end()) {
    fitted_ = &information_;
    estimator_->set_reading(reading_, covariance_, information_);
    return reading_.num_usable;
  }
  used_reading_ = reading_;
  for (Eigen::Index s = 0; s < array_.num_sensors; ++s) {
    if (outliers[static_cast<std::size_t>(s)] == 0) continue;
    for (Eigen::Index axis = 0; axis < array_.num_axes; ++axis) {
      double& usable = used_reading_.usable[array_.channel(s, axis)];
      if (usable > 0) --used_reading_.num_usable;
      usable = 0;
    }
  }
  weigh(used_reading_, used_covariance_, used_information_);
  fitted_ = &used_information_;
  estimator_->set_reading(used_reading_, used_covariance_, used_information_);
  return used_reading_.num_usable;
}

Eigen::Vector3d MagneticLocalizer::uniform_field(const FieldInformation& information,
                                                 const Eigen::VectorXd& field) const {
  Eigen::Matrix3d matrix;
  Eigen::Vector3d vector;
  sum_up(information, field, matrix, vector);
  matrix.diagonal().array() += 1 / (prior_.background_std * prior_.background_std);
  return matrix.llt().solve(vector);
}

int MagneticLocalizer::find_outliers(double sigmas, std::vector<char>& outliers) {
  sensor_misfits(information_, field_, misfits_);
  outliers.assign(static_cast<std::size_t>(array_.num_sensors), 0);
  double limit = sigmas * sigmas;
  if ((misfits_.array() <= limit).all()) return 0;
  sorted_.clear();
  for (Eigen::Index s = 0; s < array_.num_sensors; ++s) {
    if (information_.scalar[s] > 0) {
      sorted_.push_back(misfits_[s] / static_cast<double>(array_.num_axes));
    }
  }
  const auto middle = sorted_.begin() + static_cast<std::ptrdiff_t>(sorted_.size() / 2);
  std::nth_element(sorted_.begin(), middle, sorted_.end());
  limit *= std::max(1.0, *middle);
  int count = 0;
  for (std::size_t s = 0; s < outliers.size(); ++s) {
    outliers[s] = misfits_[static_cast<Eigen::Index>(s)] > limit ? 1 : 0;
    count += outliers[s];
  }
  return count;
}

double MagneticLocalizer::residual_rms() const {
  const CleanReading& reading = fitted_ == &information_ ? reading_ : used_reading_;
  const Eigen::Index n = array_.num_sensors;
  double sum = 0;
  for (Eigen::Index axis = 0; axis < array_.num_axes; ++axis) {
    const auto row = static_cast<std::size_t>(3 * axis);
    sum += (reading.usable.segment(axis * n, n).array() *
            (reading.value.segment(axis * n, n) -
             array_.response[row].cwiseProduct(field_.segment(0, n)) -
             array_.response[row + 1].cwiseProduct(field_.segment(n, n)) -
             array_.response[row + 2].cwiseProduct(field_.segment(2 * n, n)))
                .array()
                .square())
               .sum();
  }
  return std::sqrt(sum / reading.num_usable);
}

}  // namespace gastronaut::magnetics

// From one reading of the Hall array to the 5-DoF pose of the capsule's magnet.
//
// Every reading is a measurement of its own: the last fix is where the fit starts, never a part of
// the result, and the covariance is that of this one reading.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <vector>

#include "configuration/rig_configuration.hpp"
#include "geometry/se3.hpp"
#include "magnetic_localizer/global_search.hpp"
#include "magnetic_localizer/magnet_fit.hpp"
#include "magnetic_localizer/magnet_model.hpp"
#include "magnetic_localizer/noise_model.hpp"
#include "magnetic_localizer/sensor_array.hpp"

namespace gastronaut::magnetics {

// Values as in magnetic_pose_t.
enum class FixStatus : std::int8_t {
  kOk = 0,
  kNoFix = 1,         // did not converge
  kTooFar = 2,        // the signal is too weak: predicted error over the configured limit
  kInterference = 3,  // far from what a magnet and a uniform background explain
  kSaturated = 4,     // too many saturated or faulty sensors
  kNoCurrents = 5,    // coil currents missing, actuation field not removed
};

struct MagneticFix {
  FixStatus status = FixStatus::kNoFix;
  MagnetState state;
  // Position (m^2), two rotations (rad^2) about perpendicular_basis(axis). The Cramer-Rao bound of
  // the configured noise, times chi2_per_dof where that is significantly above one. With a field
  // that is not in the model, plus the size of the search box; without a solution, that alone.
  Matrix5d covariance = Matrix5d::Zero();
  double residual_rms = 0;  // tesla, over the channels used
  double chi2_per_dof = 0;
  int num_channels_used = 0;
};

class MagneticLocalizer {
 public:
  // Throws ConfigurationError where the estimator cannot work with the array.
  explicit MagneticLocalizer(const RigConfiguration& configuration);

  // Sizes must be those of the configuration. Currents in ampere, nothing when they are missing;
  // without coils in the configuration they are not needed.
  MagneticFix localize(const HallReading& reading, const std::optional<Eigen::VectorXd>& currents);
  // For a reading that cannot be used at all.
  MagneticFix no_reading() const { return unknown_pose(FixStatus::kNoFix); }

 private:
  // A reading explained from one starting point.
  struct Solution {
    MagnetFit fit;
    int num_outliers = 0;  // sensors left out because they disagree
    int num_channels_used = 0;
    int degrees_of_freedom = 0;
    double chi2_per_dof = 0;
    double residual_rms = 0;  // tesla
    // Misfit with every sensor's share limited: compares solutions. Infinite without convergence.
    double cost = std::numeric_limits<double>::infinity();
  };

  Solution explain(const MagnetState& start);
  std::vector<MagnetState> search();
  bool explains(const Solution& solution) const;
  bool background_explains();
  MagneticFix unknown_pose(FixStatus status) const;
  MagneticFix judge(const Solution& solution, bool coil_field_left_in);

  // What `reading` says, weighed for the field in field_.
  void weigh(const CleanReading& reading, SensorMatrices& covariance,
             FieldInformation& information) const;
  // Gives the estimator the reading without the outliers; returns the channels left.
  int leave_out(const std::vector<char>& outliers);
  // What a uniform field on top of `field` explains of the readings.
  Eigen::Vector3d uniform_field(const FieldInformation& information,
                                const Eigen::VectorXd& field) const;
  // Sensors that the field in field_ misses by more than `sigmas`, and by more than that many times
  // what is common in this reading. Returns how many.
  int find_outliers(double sigmas, std::vector<char>& outliers);
  double residual_rms() const;

  MagneticLocalizerConfiguration limits_;
  Prior prior_;
  bool has_coils_;
  SensorArray array_;
  ReadingCleaner cleaner_;
  MagnetModel model_;
  NoiseModel noise_;
  GlobalSearch search_;
  std::unique_ptr<Estimator> estimator_;
  std::optional<MagnetState> last_;  // good fix
  int readings_until_search_ = 0;
  int patience_ = 1;  // readings between searches that do not help

  // Workspace, so that a warm fix allocates nothing.
  CleanReading reading_;
  CleanReading used_reading_;  // without outliers
  SensorMatrices covariance_;
  SensorMatrices used_covariance_;
  FieldInformation information_;
  FieldInformation used_information_;
  const FieldInformation* fitted_ = nullptr;  // one of the two above
  Eigen::VectorXd field_;
  Eigen::VectorXd misfits_;  // each sensor's
  std::vector<double> sorted_;
  std::vector<char> outliers_;
  std::vector<char> new_outliers_;
};

}  // namespace gastronaut::magnetics

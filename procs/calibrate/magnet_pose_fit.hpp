// Pose of the magnet and the uniform background from one reading, sensors as configured: the start
// of the joint calibration and the measure of how well a configuration explains a log.
//
// reading = response (B_magnet(position, axis) + background) + offset + coil matrix * currents,
// solved by Levenberg-Marquardt on axial_magnet_derivatives, robust to wrong channels. Without a
// start the magnet is searched for on a coarse grid, where moment and background are linear. It is
// below the sensors: a mono-axial array cannot tell a magnet from its mirror image above.
#pragma once

#include <optional>
#include <vector>

#include "calibrate/calibration_readings.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

struct MagnetPoseFit {
  MagnetPose pose;
  Eigen::Vector3d background = Eigen::Vector3d::Zero();  // tesla, rig frame
  double rms = 0;                                        // tesla, residual of the channels used
  double chi2_per_channel = 0;                           // robust, offsets' errors included
  double strongest = 0;                                  // tesla, the magnet's at any sensor
  double outlier_fraction = 0;  // of the usable channels, those beyond the robust knee
};

class MagnetPoseFitter {
 public:
  explicit MagnetPoseFitter(const RigConfiguration& rig);

  // Nothing where the fit does not converge below the array or too few channels are usable.
  std::optional<MagnetPoseFit> fit(const CalibrationReading& reading,
                                   const std::optional<MagnetPose>& start) const;

  // How much of the variation of `field` (tesla, channel by channel, every channel usable) over the
  // array a magnet of any strength explains: 1 - residual / variation about a uniform field.
  double explained_by_magnet(const Eigen::VectorXd& field) const;

 private:
  struct Channel {
    Eigen::Index sensor;
    Eigen::RowVector3d response;
    double offset;
  };
  struct Cost {
    double value = 0;
    double squares = 0;
    int used = 0;
    int outliers = 0;
  };
  Eigen::VectorXd without_coils(const CalibrationReading& reading) const;
  MagnetPose search(const Eigen::VectorXd& field, const std::vector<bool>& usable,
                    double* residual) const;
  Cost cost(const Eigen::VectorXd& field, const std::vector<bool>& usable, const MagnetPose& pose,
            const Eigen::Vector3d& background) const;

  std::vector<Eigen::Vector3d> positions_;
  std::vector<Channel> channels_;
  double lowest_sensor_;  // metres, rig z
  Eigen::MatrixXd coil_matrix_;
  double moment_;
  double octupole_ratio_;
  double sigma_;  // tesla: noise and offset error together
  MagneticLocalizerConfiguration search_;
};

}  // namespace gastronaut

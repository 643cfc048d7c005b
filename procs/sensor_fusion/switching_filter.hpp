// Magneto-visual fusion that knows which sensor to believe: a particle filter with a switch and a
// confidence for each sensor (paper, section on fusion; Caron et al. 2007), Rao-Blackwellised.
//
// Particles (switch_particles.hpp) hold histories of failures; the pose given such a history is a
// sum of Gaussians (belief_mixture.hpp): what a magnet cannot tell, the roll about its axis, starts
// as `rolls` hypotheses that the first motions decide between.
//
// Vision is in a map of its own: its similarity to the rig is part of the belief, drifts, and is
// established anew from the present pose whenever vision's map is another one. So a sensor that
// comes back never makes the pose jump by more than it was uncertain.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "sensor_fusion/belief_mixture.hpp"
#include "sensor_fusion/clock_watch.hpp"
#include "sensor_fusion/switch_particles.hpp"

namespace gastronaut::fusion {

enum class Sensor : std::size_t { kMagnetic = 0, kVisual = 1 };

enum class FusionStatus : std::int8_t {
  kInitialising = 0,  // the sensors are well, the roll is still open
  kNominal = 1,
  kDegraded = 2,    // at least one sensor has failed
  kPredicting = 3,  // every sensor has failed
};

struct FilterOptions {
  BeliefModel model;
  bool position_and_rotation_only = false;  // the paper's observation model
  std::size_t particles = 1000;
  std::uint64_t seed = 1;
  double alpha_memory = 50;
  double failure_threshold = 0.5;
  SE3 camera_T_magnet;
  double hand_eye_position_std = 3e-4;  // metres
  double hand_eye_axis_std = 5e-3;      // radians
  double time_offset = 0;               // seconds
  double time_offset_std = 2e-3;
  double depth_scale_std = 0.05;

  int rolls = 24;                    // hypotheses about the roll
  double known_roll = 0.1;           // radians, one sigma: the filter has begun
  double start_velocity_std = 0.05;  // m/s
  double start_turn_std = 1;         // rad/s
  // Share of unusable measurements (lost frames, refused fixes) from a sensor that works.
  double unusable_share = 0.03;
  // A sensor that says to be well and contradicts for so long, seconds: vision's map is another
  // one; the magnet is right and the pose was wrong.
  double visual_patience = 0.4;
  double magnetic_patience = 2;
  double silence = 2.5;  // a sensor is silent after so many of its usual intervals
};

struct MagneticMeasurement {
  std::int64_t utime = 0;
  bool is_usable = false;
  std::string cause;  // why it is not
  MagneticFix fix;
};

struct VisualMeasurement {
  std::int64_t utime = 0;
  bool is_usable = false;
  std::string cause;
  int map_version = 0;
  SE3 map_T_camera;
  // As VISUAL_POSE has it: of the pose in the map, drift included.
  Matrix6d covariance = Matrix6d::Zero();
  bool is_degraded = false;
};

struct SensorHealth {
  double nominal = 0.5;  // posterior of the switch
  double alpha = 0.5;
  bool is_used = false;
  std::string cause;  // of a failure; empty when nominal
};

struct FusedState {
  std::int64_t utime = 0;
  FusionStatus status = FusionStatus::kInitialising;
  SE3 rig_T_camera;
  Eigen::Vector3d velocity = Eigen::Vector3d::Zero();          // rig frame, m/s
  Eigen::Vector3d angular_velocity = Eigen::Vector3d::Zero();  // camera frame, rad/s
  Matrix6d covariance = Matrix6d::Zero();  // translation rig frame, rotation camera frame
  double depth_scale = 1;
  std::array<SensorHealth, kNumSensors> sensors;
};

// What the measurements say of the calibration themselves, by a belief that knows little of it.
struct CalibrationCheck {
  Eigen::Vector3d magnet_position = Eigen::Vector3d::Zero();  // metres, camera frame
  double axis_change = 0;                                     // radians from the configured one
  ClockEstimate clock;
  // Mahalanobis distance squared from the configured hand-eye calibration, of 5 numbers: 5 on
  // average where it fits. Zero while nothing is known.
  double hand_eye_chi2 = 0;
};

class SwitchingFilter {
 public:
  // Throws std::invalid_argument for options that make no sense.
  explicit SwitchingFilter(const FilterOptions& options);

  // utimes must not descend. Every call gives the state at the measurement's utime, finite whatever
  // the measurement holds.
  FusedState update(const MagneticMeasurement& measurement);
  FusedState update(const VisualMeasurement& measurement);

  CalibrationCheck check_calibration() const;
  // Gaussians, over all histories of failures.
  std::size_t num_beliefs() const;
  const SwitchParticles& particles() const { return particles_; }

 private:
  struct SensorRecord {
    SensorHealth health;
    std::optional<std::int64_t> last;  // utime of the last measurement
    double since_last = 0;             // seconds from the one before to that
    double interval = 0;               // seconds between measurements, usual
    std::int64_t silence_noticed = 0;  // utime up to which silence was counted
    double refused_for = 0;            // seconds: usable, but not believed
    double inflation = 1;              // of its variance, as the innovations show it
    std::string told_cause;            // of its last unusable measurement
  };

  void advance(std::int64_t utime);
  void note_arrival(Sensor sensor, std::int64_t utime);
  void notice_silence(Sensor sensor, std::int64_t utime);
  void count_unusable(Sensor sensor, const std::string& cause);
  void begin(const MagneticFix& fix);
  void begin_rolls(const CapsuleBelief& belief);
  void begin_again(const MagneticFix& fix);
  void meet_map(const VisualMeasurement& measurement);
  void establish_maps(const VisualMeasurement& measurement);
  bool has_moved(const VisualMeasurement& measurement) const;
  void let_maps_drift(const VisualMeasurement& measurement);
  Matrix6d visual_noise(const VisualMeasurement& measurement) const;
  using Observe = std::function<Innovation(const CapsuleBelief&)>;
  void assimilate(Sensor sensor, const Observe& observe);
  void learn_noise(Sensor sensor, const Gain& gain);
  void learn_drift(const Gain& magnetic);
  bool follows_the_last(const MagneticMeasurement& measurement) const;
  void learn_scatter(std::int64_t utime, const MagneticFix& fix);
  void begin_check();
  void watch_clock(const VisualMeasurement& measurement);
  std::size_t likeliest_history() const;
  const CapsuleBelief& likeliest() const;
  void for_each_belief(const std::function<void(CapsuleBelief&)>& action);
  void branch(const std::vector<MixtureGain>& gains);
  void set_health(Sensor sensor, double nominal);
  bool failed(Sensor sensor) const;
  FusedState state(std::int64_t utime);
  SensorRecord& record(Sensor sensor) { return sensors_[static_cast<std::size_t>(sensor)]; }
  const SensorRecord& record(Sensor sensor) const {
    return sensors_[static_cast<std::size_t>(sensor)];
  }

  FilterOptions options_;
  SwitchParticles particles_;
  std::vector<BeliefMixture> histories_;  // of failures; none before the first magnetic fix
  std::optional<CapsuleBelief> check_;    // learns the calibration; never fused
  ClockWatch clock_;
  std::int64_t utime_ = 0;
  std::array<SensorRecord, kNumSensors> sensors_;
  Matrix6d bias_covariance_ = Matrix6d::Zero();
  std::optional<MagneticFix> last_fix_;  // unless what came after it was none
  std::int64_t last_fix_utime_ = 0;
  double scatter_ = 1;      // of one fix to the next, as a part of the variance that they state
  bool has_begun_ = false;  // the roll was known once

  std::optional<int> map_version_;
  std::optional<SE3> last_map_T_camera_;  // of the last usable VISUAL_POSE of this map
  std::int64_t last_frame_utime_ = 0;
  std::optional<Matrix6d> well_held_;  // its covariance when vision was last well
  // How much faster vision drifts than the model has it: what drifts too fast for the model leaves
  // magnetic innovations that resemble the ones before.
  double drift_inflation_ = 1;
  Eigen::Vector3d recent_innovation_ = Eigen::Vector3d::Zero();  // whitened, of the position
  double scale_of_map_ = 1;  // raw depth times this is what the map is made of
  double told_scale_ = 1;    // depth_scale of the state that answered the last VISUAL_POSE
};

}  // namespace gastronaut::fusion

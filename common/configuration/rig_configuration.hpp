// The whole configuration of a rig and of every process on it: one YAML file, plain structs that
// hold the defaults. RIG_CONFIG carries it, so that a log explains itself.
//
// SI units. Frames as in architecture.md: `rig` is the Hall array's, z up.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "camera/camera_model.hpp"
#include "configuration/fields.hpp"
#include "geometry/se3.hpp"
#include "magnetics/axial_magnet.hpp"

namespace gastronaut {

struct TransformConfiguration {
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  // metres
  std::vector<double> rotation = {1, 0, 0, 0};            // unit quaternion w x y z

  SE3 transform() const;
  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("translation", translation, any(Dimension::kLength));
    v("rotation", rotation);
  }
};

struct CameraConfiguration {
  int width = 640;  // pixels
  int height = 480;
  double fx = 332.8;
  double fy = 332.8;
  double cx = 319.5;
  double cy = 239.5;
  LensModel model = LensModel::kRadialTangential;
  std::vector<double> distortion;  // OpenCV's order
  double rate = 20;                // frames a second
  // Linear light L = exposure_gain * cos^vignetting_cos_power(ray) * sum over lights of
  // led_intensity cos^lobe / r^2 * albedo * cos(normal, light); the pixel is 255 L^(1/gamma).
  double gamma = 2.2;
  // As `calibrate light` measures it: L at equally spaced levels, the first 0 (level 0), the last 1
  // (level 255), straight in between. Empty: gamma.
  std::vector<double> response;
  double exposure_gain = 1;
  double led_intensity = 2.2e-4;  // square metres: unit albedo at distance d gives this / d^2
  double vignetting_cos_power = 1;
  // The picture's metadata "gain" multiplies exposure_gain; without auto-exposure it is 1.
  bool auto_exposure = false;
  // One sigma of the linear light's noise, full scale being 1: sqrt(read_noise^2 + shot_noise^2 L).
  double read_noise = 0.002;
  double shot_noise = 0.01;
  double metres_per_depth_count = 5e-5;

  CameraIntrinsics intrinsics() const;
  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("width", width, between(1, 16384));
    v("height", height, between(1, 16384));
    v("fx", fx, positive());
    v("fy", fy, positive());
    v("cx", cx);
    v("cy", cy);
    v("model", model,
      std::vector<Choice<LensModel>>{{"radial_tangential", LensModel::kRadialTangential},
                                     {"fisheye", LensModel::kFisheye}});
    v("distortion", distortion);
    v("rate", rate, positive(Dimension::kFrequency));
    v("gamma", gamma, between(0.2, 5));
    v("response", response);
    v("exposure_gain", exposure_gain, between(1e-6, 1e6));
    v("led_intensity", led_intensity, between(1e-12, 1));
    v("vignetting_cos_power", vignetting_cos_power, not_negative());
    v("auto_exposure", auto_exposure);
    v("read_noise", read_noise, not_negative());
    v("shot_noise", shot_noise, not_negative());
    v("metres_per_depth_count", metres_per_depth_count, positive(Dimension::kLength));
  }
};

// Light k of `count` sits at radius (cos, sin)(2 pi k / count + phase) in the lens plane and shines
// along the optical axis with cos^lobe.
struct LightsConfiguration {
  int count = 4;
  double radius = 0.0032;  // metres
  double phase = 0.3;      // radians
  double lobe = 1.2;

  template <class Visitor>
  void fields(Visitor& v) {
    v("count", count, between(1, 64));
    v("radius", radius, not_negative(Dimension::kLength));
    v("phase", phase, any(Dimension::kAngle));
    v("lobe", lobe, between(0, 50));
  }
};

struct MagnetConfiguration {
  double moment = 0.408;         // A m^2
  double moment_std = 0.004;     // one sigma of what is known of it; 0: exactly known
  double outer_radius = 0.0055;  // metres; all three zero: a point dipole
  double inner_radius = 0.003;
  double length = 0.006;

  AxialMagnetShape shape() const { return {outer_radius, inner_radius, length}; }
  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("moment", moment, positive(Dimension::kMagneticMoment));
    v("moment_std", moment_std, not_negative(Dimension::kMagneticMoment));
    v("outer_radius", outer_radius, not_negative(Dimension::kLength));
    v("inner_radius", inner_radius, not_negative(Dimension::kLength));
    v("length", length, not_negative(Dimension::kLength));
  }
};

// One Hall sensor: reading = response * B(position) + offset, B in the rig frame.
struct HallSensorConfiguration {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();  // metres, rig frame
  // num_axes x 3, one row a measured axis: its direction in the rig frame times its gain.
  Eigen::MatrixXd response = Eigen::Matrix3d::Identity();
  std::vector<double> offset;  // tesla, one an axis; empty: zero

  template <class Visitor>
  void fields(Visitor& v) {
    v("position", position, any(Dimension::kLength));
    v("response", response);
    v("offset", offset, any(Dimension::kMagneticField));
  }
};

// Where the sensors are: listed one by one, or (when `sensors` is empty) a regular grid in the
// plane z with sensor row * cols + col at ((row - (rows-1)/2) pitch, (col - (cols-1)/2) pitch, z),
// its axes along the rig's (num_axes 3) or z alone (num_axes 1).
struct HallArrayConfiguration {
  int rows = 8;
  int cols = 8;
  double pitch = 0.022;          // metres
  double z = 0.085;              // metres
  int num_axes = 3;              // 3 or 1
  double rate = 100;             // readings a second
  double noise = 1.5e-6;         // tesla, one sigma of one axis
  double gain_std = 0.005;       // one sigma of what calibration leaves: relative gain error,
  double alignment_std = 0.005;  // misalignment in radians,
  double offset_std = 1e-6;      // and offset in tesla; part of the localiser's noise model
  double saturation = 0.01;      // tesla, per axis; readings at or beyond it are not used
  std::vector<HallSensorConfiguration> sensors;

  int num_sensors() const;
  // The list, or the grid spelled out.
  std::vector<HallSensorConfiguration> resolved_sensors() const;
  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("rows", rows, between(1, 256));
    v("cols", cols, between(1, 256));
    v("pitch", pitch, positive(Dimension::kLength));
    v("z", z, any(Dimension::kLength));
    v("num_axes", num_axes, between(1, 3));
    v("rate", rate, positive(Dimension::kFrequency));
    v("noise", noise, positive(Dimension::kMagneticField));
    v("gain_std", gain_std, not_negative());
    v("alignment_std", alignment_std, not_negative(Dimension::kAngle));
    v("offset_std", offset_std, not_negative(Dimension::kMagneticField));
    v("saturation", saturation, positive(Dimension::kMagneticField));
    v.list("sensors", sensors);
  }
};

struct CoilsConfiguration {
  // Readings (channel by channel: sensor by sensor, its axes in order) per ampere in each coil, as
  // `calibrate coils` measures them. Empty: the rig has no coils.
  Eigen::MatrixXd tesla_per_ampere;
  double current_noise = 0.002;        // ampere, one sigma
  double tesla_per_ampere_std = 2e-8;  // one sigma of what calibration leaves in each entry

  template <class Visitor>
  void fields(Visitor& v) {
    v("tesla_per_ampere", tesla_per_ampere, any(Dimension::kFieldPerCurrent));
    v("current_noise", current_noise, not_negative(Dimension::kCurrent));
    v("tesla_per_ampere_std", tesla_per_ampere_std, not_negative(Dimension::kFieldPerCurrent));
  }
};

enum class MagneticEstimator {
  kFullField,         // weighted Levenberg-Marquardt on the readings, background as an unknown
  kSecondDifference,  // the paper's second-order directional differentiation
};

struct MagneticLocalizerConfiguration {
  MagneticEstimator estimator = MagneticEstimator::kFullField;
  // As one more unknown, with magnet.moment_std as its prior; else it is taken as exactly known.
  bool estimate_moment = true;
  double background_std = 1e-4;     // tesla, one sigma of the uniform background's prior, per axis
  double max_position_std = 0.005;  // metres: a fix that predicts worse is TOO_FAR
  double max_axis_std = 0.2;        // radians, likewise
  double interference_chi2 = 6;     // chi2_per_dof above this is INTERFERENCE
  double outlier_sigmas = 5;        // sensors further off than this are left out
  double max_outlier_fraction = 0.15;  // more sensors off than this: the field is foreign
  double min_channel_fraction = 0.5;   // fewer usable channels than this: SATURATED
  double max_current_gap = 0.1;        // seconds between coil samples that are still bridged
  // Readings are searched for the magnet from scratch within this box around the array centre.
  double search_half_width = 0.15;  // metres, x and y
  double search_depth = 0.30;       // metres below the array

  template <class Visitor>
  void fields(Visitor& v) {
    v("estimator", estimator,
      std::vector<Choice<MagneticEstimator>>{
          {"full_field", MagneticEstimator::kFullField},
          {"second_difference", MagneticEstimator::kSecondDifference}});
    v("estimate_moment", estimate_moment);
    v("background_std", background_std, positive(Dimension::kMagneticField));
    v("max_position_std", max_position_std, positive(Dimension::kLength));
    v("max_axis_std", max_axis_std, positive(Dimension::kAngle));
    v("interference_chi2", interference_chi2, positive());
    v("outlier_sigmas", outlier_sigmas, positive());
    v("max_outlier_fraction", max_outlier_fraction, between(0, 0.5));
    v("min_channel_fraction", min_channel_fraction, between(0, 1));
    v("max_current_gap", max_current_gap, positive(Dimension::kTime));
    v("search_half_width", search_half_width, positive(Dimension::kLength));
    v("search_depth", search_depth, positive(Dimension::kLength));
  }
};

enum class DepthSource {
  kShading,  // DEPTH is made from the shading of each picture
  kSensor,   // DEPTH comes from elsewhere (RGB-D); the camera carries no lamp
};

struct DepthEstimatorConfiguration {
  DepthSource depth = DepthSource::kShading;
  // DEPTH's grid is the picture's over the smallest whole number that makes it no wider than this.
  int max_width = 320;  // pixels
  // Mean albedo of tissue in red, green and blue. camera.led_intensity times this is what
  // `calibrate light` measures, so one of the two is a convention.
  std::vector<double> albedo = {0.785, 0.444, 0.368};
  double albedo_std = 0.08;  // relative variation of the albedo over the wall, one sigma
  // Relative, one sigma: exposure under auto-exposure when the pictures do not carry their gain.
  double unknown_gain_std = 0.3;
  double min_depth = 0.004;  // metres
  double max_depth = 0.15;
  // Shape from shading: curvature below 1 / this costs less than an error of data_std does.
  double curvature_radius = 0.002;  // metres
  double data_std = 0.05;           // of ln(light): noise and small patterns of the albedo
  std::vector<double> vessel_scales = {1, 1.6, 2.5, 4, 6};  // pixels, one sigma of the Gaussian

  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("depth", depth,
      std::vector<Choice<DepthSource>>{{"shading", DepthSource::kShading},
                                       {"sensor", DepthSource::kSensor}});
    v("max_width", max_width, between(16, 4096));
    v("albedo", albedo);
    v("albedo_std", albedo_std, between(0.001, 1));
    v("unknown_gain_std", unknown_gain_std, between(0, 10));
    v("min_depth", min_depth, between(1e-4, 10, Dimension::kLength));
    v("max_depth", max_depth, between(1e-4, 10, Dimension::kLength));
    v("curvature_radius", curvature_radius, between(1e-5, 0.1, Dimension::kLength));
    v("data_std", data_std, between(1e-3, 1));
    v("vessel_scales", vessel_scales);
  }
};

struct VisualSlamConfiguration {
  // Typical distance of what the camera sees; all of the map's lengths go with it.
  double working_distance = 0.04;  // metres; 2 in a room
  int max_width = 320;             // pixels: pictures are halved (or more) until no wider
  double rgb_weight = 0.13;        // w_rgb of the paper: weight of colour beside depth
  // Surfels that were merged fewer times than this are removed when they stay unseen. Depth from
  // shading is merged by keyframes, a sensor's frame by frame: there 10 is right.
  double stable_confidence = 3;
  bool deformation = true;    // the map bends into place; off: it is rigid
  double map_interval = 0.5;  // seconds between two MAP_SURFELS
  double save_interval = 5;   // seconds between two saves of the map (--map)

  template <class Visitor>
  void fields(Visitor& v) {
    v("working_distance", working_distance, between(1e-3, 100, Dimension::kLength));
    v("max_width", max_width, between(80, 4096));
    v("rgb_weight", rgb_weight, between(0, 100));
    v("stable_confidence", stable_confidence, between(0.1, 200));
    v("deformation", deformation);
    v("map_interval", map_interval, between(0.01, 1e6, Dimension::kTime));
    v("save_interval", save_interval, between(0.01, 1e6, Dimension::kTime));
  }
};

enum class ObservationModel {
  kPaper,  // position from the magnet, rotation from vision
  kFull,   // also the magnet's axis, and vision's translation with its unknown scale
};

struct SensorFusionConfiguration {
  ObservationModel model = ObservationModel::kFull;
  int particles = 1000;
  std::uint64_t seed = 1;
  // sigma_alpha of Caron et al. 2007: for how many measurements a confidence is remembered.
  double alpha_memory = 50;
  // A sensor whose switch is nominal with less than this probability has failed.
  double failure_threshold = 0.5;
  // How the capsule moves: white noise of acceleration, one sigma over a second.
  double acceleration_std = 0.02;         // m/s^2 sqrt(s)
  double angular_acceleration_std = 0.3;  // rad/s^2 sqrt(s)
  // What `calibrate hand-eye` leaves unknown of camera_T_magnet, one sigma an axis.
  double hand_eye_position_std = 3e-4;  // metres
  double hand_eye_axis_std = 5e-3;      // radians
  // A Hall reading stamped t was taken at t + magnetic_time_offset of the camera's clock.
  double magnetic_time_offset = 0;  // seconds
  double magnetic_time_offset_std = 2e-3;
  double depth_scale_std = 0.05;  // of what visual depth is off by at the start, relative

  template <class Visitor>
  void fields(Visitor& v) {
    v("model", model,
      std::vector<Choice<ObservationModel>>{{"paper", ObservationModel::kPaper},
                                            {"full", ObservationModel::kFull}});
    v("particles", particles, between(10, 100000));
    v("seed", seed);
    v("alpha_memory", alpha_memory, between(1, 1e6));
    v("failure_threshold", failure_threshold, between(0.01, 0.99));
    v("acceleration_std", acceleration_std, positive());
    v("angular_acceleration_std", angular_acceleration_std, positive());
    v("hand_eye_position_std", hand_eye_position_std, not_negative(Dimension::kLength));
    v("hand_eye_axis_std", hand_eye_axis_std, not_negative(Dimension::kAngle));
    v("magnetic_time_offset", magnetic_time_offset, between(-1, 1, Dimension::kTime));
    v("magnetic_time_offset_std", magnetic_time_offset_std, not_negative(Dimension::kTime));
    v("depth_scale_std", depth_scale_std, between(1e-4, 1));
  }
};

struct OccupancyMapperConfiguration {
  // Edge of the smallest cube, as a fraction of visual_slam.working_distance: 1 mm in a stomach,
  // 5 cm in a room.
  double resolution = 0.025;
  double map_interval = 1;   // seconds between two OCTOMAP
  double save_interval = 5;  // seconds between two writes of the file (--octomap)
  double pose_age = 2;       // seconds: surfels may be older than the camera pose that saw them

  template <class Visitor>
  void fields(Visitor& v) {
    v("resolution", resolution, between(1e-3, 1));
    v("map_interval", map_interval, between(0.01, 1e6, Dimension::kTime));
    v("save_interval", save_interval, between(0.01, 1e6, Dimension::kTime));
    v("pose_age", pose_age, between(0.01, 60, Dimension::kTime));
  }
};

// Where the Hall array's readings come from. Which signals of the CAN database are which sensor,
// axis and coil is told by their names: {sensor} and {coil} stand for their numbers, {axis} for x,
// y, z (z for sensors of one axis).
struct CanHallArrayConfiguration {
  std::string interface = "can0";
  std::string dbc = "hall_array.dbc";  // beside the configuration file, unless absolute
  std::string field_signal = "sensor{sensor}_{axis}";   // in T, mT, uT or nT
  std::string status_signal = "sensor{sensor}_status";  // bits of hall_array_t; may be missing
  std::string current_signal = "coil{coil}_current";    // in A, mA, uA or nA; may be missing
  std::string counter_signal = "cycle";                 // in every message that is used
  int first_number = 0;                                 // of sensors and coils
  double timeout = 0.02;  // seconds from a reading's first frame until what has not come is stale

  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("interface", interface);
    v("dbc", dbc);
    v("field_signal", field_signal);
    v("status_signal", status_signal);
    v("current_signal", current_signal);
    v("counter_signal", counter_signal);
    v("first_number", first_number, between(0, 1000));
    v("timeout", timeout, between(1e-4, 10, Dimension::kTime));
  }
};

// Which camera, and how it is set (drivers/uvc_camera). Size and rate: CameraConfiguration.
struct UvcCameraConfiguration {
  std::string back_end = "auto";  // usb: through libusb; v4l2: the kernel's; auto: who has it
  std::string vendor;             // four hexadecimal digits, as lsusb shows them; empty: any
  std::string product;
  std::string serial;
  std::string device;           // of v4l2, as /dev/video0; empty: the first one that fits
  std::string format = "auto";  // mjpeg, yuyv; auto: mjpeg if the camera has it
  // What is not given stays as the camera has it at the driver's start.
  double exposure = 0;    // seconds; 0: not given
  int gain = -1;          // in the camera's units; -1: not given
  int white_balance = 0;  // kelvin; 0: not given
  // The exposure that `calibrate light` saw: a picture's metadata "gain" is the ratio to it.
  double calibrated_exposure = 0;  // seconds; 0: exposure is the one

  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("back_end", back_end);
    v("vendor", vendor);
    v("product", product);
    v("serial", serial);
    v("device", device);
    v("format", format);
    v("exposure", exposure, between(0, 10, Dimension::kTime));
    v("gain", gain, between(-1, 65535));
    v("white_balance", white_balance, between(0, 20000));
    v("calibrated_exposure", calibrated_exposure, between(0, 10, Dimension::kTime));
  }
};

// How long an input may lag behind in event time before it counts as silent (architecture.md).
struct LagConfiguration {
  double camera = 0.5;  // seconds
  double hall_array = 0.5;
  double coil_currents = 0.5;
  double derived = 1.0;   // outputs of other processes
  double fusion = 0.4;    // the poses that sensor_fusion joins: a silent sensor is noticed after it
  double feedback = 0.2;  // CAPSULE_STATE, which visual_slam waits for

  template <class Visitor>
  void fields(Visitor& v) {
    v("camera", camera, positive(Dimension::kTime));
    v("hall_array", hall_array, positive(Dimension::kTime));
    v("coil_currents", coil_currents, positive(Dimension::kTime));
    v("derived", derived, positive(Dimension::kTime));
    v("fusion", fusion, positive(Dimension::kTime));
    v("feedback", feedback, positive(Dimension::kTime));
  }
};

struct RigConfiguration {
  std::string name = "rig";
  CameraConfiguration camera;
  LightsConfiguration lights;
  MagnetConfiguration magnet;
  TransformConfiguration camera_T_magnet;
  HallArrayConfiguration hall_array;
  CoilsConfiguration coils;
  CanHallArrayConfiguration can_hall_array;
  UvcCameraConfiguration uvc_camera;
  LagConfiguration lag;
  MagneticLocalizerConfiguration magnetic_localizer;
  DepthEstimatorConfiguration depth_estimator;
  VisualSlamConfiguration visual_slam;
  SensorFusionConfiguration sensor_fusion;
  OccupancyMapperConfiguration occupancy_mapper;

  // Throws std::invalid_argument where sections contradict each other.
  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("name", name);
    v.section("camera", camera);
    v.section("lights", lights);
    v.section("magnet", magnet);
    v.section("camera_T_magnet", camera_T_magnet);
    v.section("hall_array", hall_array);
    v.section("coils", coils);
    v.section("can_hall_array", can_hall_array);
    v.section("uvc_camera", uvc_camera);
    v.section("lag", lag);
    v.section("magnetic_localizer", magnetic_localizer);
    v.section("depth_estimator", depth_estimator);
    v.section("visual_slam", visual_slam);
    v.section("sensor_fusion", sensor_fusion);
    v.section("occupancy_mapper", occupancy_mapper);
  }
};

// Files (later ones override earlier ones, key by key), then "a.b=c" settings. Throws
// ConfigurationError.
RigConfiguration load_rig_configuration(const std::vector<std::string>& files,
                                        const std::vector<std::string>& settings);
// From the text that RIG_CONFIG carries, then files and settings as above.
RigConfiguration parse_rig_configuration(const std::string& yaml, const std::string& name,
                                         const std::vector<std::string>& settings = {},
                                         const std::vector<std::string>& files = {});

}  // namespace gastronaut

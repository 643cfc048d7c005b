// What the virtual rig plays: organ, trajectory, imaging, magnetics, faults and the rig that it
// stands in for, as one YAML file with a seed. Same scenario, same bytes.
//
// SI units; rig frame unless said otherwise. Times count from the scenario's start.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "configuration/fields.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

struct PeristalsisConfiguration {
  double amplitude = 0;      // metres: how far the wall moves inwards at the crest
  double wavelength = 0.06;  // metres along the organ
  double period = 15;        // seconds between crests

  template <class Visitor>
  void fields(Visitor& v) {
    v("amplitude", amplitude, between(0, 0.01, Dimension::kLength));
    v("wavelength", wavelength, positive(Dimension::kLength));
    v("period", period, positive(Dimension::kTime));
  }
};

enum class OrganShapeKind {
  kStomach,  // a bent tube with closed ends, or a mesh from a file, with folds
  kCard,     // a flat matte card of one albedo in the rig's plane z = 0, facing up: what the light
             // is calibrated with
};

// A stomach or a mesh from a file; folds, vessels and mucus in either case. Or a plain card.
struct OrganConfiguration {
  OrganShapeKind shape = OrganShapeKind::kStomach;
  std::string mesh;  // VTK legacy PolyData in millimetres; empty: the procedural stomach
  double mesh_scale = 1;
  std::uint64_t seed = 0;  // shape and texture; the scenario's seed draws everything else
  double edge = 0.0006;    // metres, typical edge of a triangle
  // A card is width x height, and what only tissue has is not looked at.
  // The procedural stomach: arc length of its axis, turn of the axis between its ends, largest
  // cross-section (horizontal, vertical), and by how much the far end is narrower than the near.
  double length = 0.145;
  double bend = 1.7;
  double width = 0.066;
  double height = 0.066;
  double taper = 0.3;
  // Cut open: the part above opening_height is missing.
  bool opened = false;
  double opening_height = 0.008;
  int folds = 12;               // rugae around the circumference
  double fold_height = 0.003;   // metres
  double bump_height = 0.0005;  // metres, of the coarsest octave
  double vessels = 1;           // density of the network, 1: 0.4 mm of vessel per mm^2
  double mucus = 1;             // strength of the highlights
  double variation = 0.06;      // relative slow variation of the albedo, one sigma
  // Albedo of the tissue between vessels, mean over the organ.
  Eigen::Vector3d albedo{0.80, 0.42, 0.33};  // red, green, blue
  PeristalsisConfiguration peristalsis;

  template <class Visitor>
  void fields(Visitor& v) {
    v("shape", shape,
      std::vector<Choice<OrganShapeKind>>{{"stomach", OrganShapeKind::kStomach},
                                          {"card", OrganShapeKind::kCard}});
    v("mesh", mesh);
    v("mesh_scale", mesh_scale, positive());
    v("seed", seed);
    v("edge", edge, between(0.0002, 0.01, Dimension::kLength));
    v("length", length, between(0.05, 0.3, Dimension::kLength));
    v("bend", bend, between(0, 2.5, Dimension::kAngle));
    v("width", width, between(0.03, 0.15, Dimension::kLength));
    v("height", height, between(0.03, 0.15, Dimension::kLength));
    v("taper", taper, between(0, 0.6));
    v("opened", opened);
    v("opening_height", opening_height, any(Dimension::kLength));
    v("folds", folds, between(0, 60));
    v("fold_height", fold_height, between(0, 0.008, Dimension::kLength));
    v("bump_height", bump_height, between(0, 0.002, Dimension::kLength));
    v("vessels", vessels, between(0, 5));
    v("mucus", mucus, between(0, 5));
    v("variation", variation, between(0, 0.3));
    v("albedo", albedo, between(0, 1));
    v.section("peristalsis", peristalsis);
  }
};

enum class TrajectoryKind {
  kTour,              // along the organ's axis and back, looking at the wall
  kStatic,            // where a tour begins
  kAbsent,            // no capsule: coils and background alone
  kArrayCalibration,  // the magnet from place to place below the array, turned every way
  kLightCalibration,  // to and fro above a card, looking at its middle square on and tilted
};

struct TrajectoryConfiguration {
  TrajectoryKind kind = TrajectoryKind::kTour;
  double path_length = 0.20;  // metres within `period`
  double period = 20;         // seconds of one tour; then it begins again
  bool returns = true;        // ends where it began; else it stops at the far end and goes back
  double standoff = 0.034;    // metres from the lens to the wall ahead, mean
  double view_angle = 0;      // radians about the organ's axis: 0 looks down
  double swing = 0.5;         // radians, how far the view swings about the axis,
  double tilt = 0.45;         // along it,
  double roll = 0.4;          // and turns about its own direction
  double swings = 1;          // how many times in one tour (whole numbers close the loop)
  // Light calibration: distances from the lens to the card along the optical axis; `tilt`, `roll`
  // and `period` as in a tour.
  double nearest = 0.008;  // metres
  double furthest = 0.05;
  // Array calibration: places visited one after the other, one every `dwell`, in a box centred
  // below the array.
  double dwell = 0.5;                                  // seconds
  Eigen::Vector3d box_centre{0, 0, 0.0};               // metres
  Eigen::Vector3d box_half_size{0.075, 0.075, 0.035};  // metres

  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("kind", kind,
      std::vector<Choice<TrajectoryKind>>{
          {"tour", TrajectoryKind::kTour},
          {"static", TrajectoryKind::kStatic},
          {"absent", TrajectoryKind::kAbsent},
          {"array_calibration", TrajectoryKind::kArrayCalibration},
          {"light_calibration", TrajectoryKind::kLightCalibration}});
    v("path_length", path_length, positive(Dimension::kLength));
    v("period", period, positive(Dimension::kTime));
    v("returns", returns);
    v("standoff", standoff, between(0.01, 0.1, Dimension::kLength));
    v("view_angle", view_angle, any(Dimension::kAngle));
    v("swing", swing, between(0, 3.2, Dimension::kAngle));
    v("tilt", tilt, between(0, 1.2, Dimension::kAngle));
    v("roll", roll, between(0, 3.2, Dimension::kAngle));
    v("swings", swings, positive());
    v("nearest", nearest, positive(Dimension::kLength));
    v("furthest", furthest, positive(Dimension::kLength));
    v("dwell", dwell, positive(Dimension::kTime));
    v("box_centre", box_centre, any(Dimension::kLength));
    v("box_half_size", box_half_size, not_negative(Dimension::kLength));
  }
};

struct ImagingConfiguration {
  bool enabled = true;         // false: no pictures and no depth
  double exposure = 0.004;     // seconds; the shutter is open half of it either side of utime
  double target_level = 0.45;  // mean grey level 0..1 that auto-exposure steers to
  int jpeg_quality = 92;

  template <class Visitor>
  void fields(Visitor& v) {
    v("enabled", enabled);
    v("exposure", exposure, between(0, 0.2, Dimension::kTime));
    v("target_level", target_level, between(0.05, 0.95));
    v("jpeg_quality", jpeg_quality, between(1, 100));
  }
};

// Circular coils with vertical axes on a grid: coil row * cols + col at
// ((row - (rows-1)/2) pitch, (col - (cols-1)/2) pitch, z), z being that of its middle.
struct CoilGeometryConfiguration {
  int rows = 3;  // 0: no coils
  int cols = 3;
  double pitch = 0.06;
  double z = -0.13;
  double inner_radius = 0.016;
  double outer_radius = 0.028;
  double length = 0.06;
  int turns = 3200;

  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("rows", rows, between(0, 16));
    v("cols", cols, between(0, 16));
    v("pitch", pitch, positive(Dimension::kLength));
    v("z", z, any(Dimension::kLength));
    v("inner_radius", inner_radius, positive(Dimension::kLength));
    v("outer_radius", outer_radius, positive(Dimension::kLength));
    v("length", length, positive(Dimension::kLength));
    v("turns", turns, between(1, 1000000));
  }
};

// What the true rig has and rig.hall_array, rig.magnet, rig.coils do not tell.
struct MagneticsConfiguration {
  // Draws what is built into the rig: sensor errors, the magnet's moment, the coil matrix. The same
  // rig in every scenario, so that what is calibrated in one holds in the others.
  std::uint64_t rig_seed = 1;
  Eigen::Vector3d background{1.9e-5, 4e-6, -4.4e-5};  // tesla, uniform
  // One sigma of the sensors' true errors; the configuration that goes out knows nothing of them.
  double gain_error = 0.005;
  double alignment_error = 0.005;  // radians
  double offset_error = 1e-6;      // tesla
  double moment_error = 0.002;     // A m^2, true moment against rig.magnet.moment
  double quantisation = 2e-7;      // tesla a count; 0: none
  double matrix_error = 2e-8;      // T/A, one sigma of what coil calibration leaves an entry
  double current_amplitude = 4;    // ampere; 0: the coils are off
  double current_offset = 0.002;   // seconds after the Hall reading that currents are measured
  CoilGeometryConfiguration coils;

  template <class Visitor>
  void fields(Visitor& v) {
    v("rig_seed", rig_seed);
    v("background", background, any(Dimension::kMagneticField));
    v("gain_error", gain_error, between(0, 0.2));
    v("alignment_error", alignment_error, between(0, 0.5, Dimension::kAngle));
    v("offset_error", offset_error, not_negative(Dimension::kMagneticField));
    v("moment_error", moment_error, not_negative(Dimension::kMagneticMoment));
    v("quantisation", quantisation, not_negative(Dimension::kMagneticField));
    v("matrix_error", matrix_error, not_negative(Dimension::kFieldPerCurrent));
    v("current_amplitude", current_amplitude, not_negative(Dimension::kCurrent));
    v("current_offset", current_offset, any(Dimension::kTime));
    v.section("coils", coils);
  }
};

enum class FaultKind {
  kTurbid,           // murky fluid: strength = extinction per metre
  kBlur,             // defocus: strength = sigma in pixels
  kOcclusion,        // tissue against the lens: strength = covered fraction of the picture
  kMagnetFar,        // the magnet is lowered by strength metres
  kForeignField,     // a second dipole: position, moment
  kSaturatedSensor,  // the listed Hall sensors sit at full scale and say so
  kStuckSensor,      // they repeat their last reading and do not say so
  kStaleSensor,      // they repeat their last reading and say so
  kLostMessages,     // messages of `channel` are lost with probability strength
};

struct FaultConfiguration {
  FaultKind kind = FaultKind::kTurbid;
  double start = 0;  // seconds
  double end = 0;
  double strength = 0;
  std::vector<int> sensors;
  std::string channel;
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();

  void check() const;
  bool active(double time) const { return time >= start && time < end; }
  // 0 outside, 1 inside, with smooth flanks: fluid and magnets do not appear at once.
  double envelope(double time) const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("kind", kind,
      std::vector<Choice<FaultKind>>{{"turbid", FaultKind::kTurbid},
                                     {"blur", FaultKind::kBlur},
                                     {"occlusion", FaultKind::kOcclusion},
                                     {"magnet_far", FaultKind::kMagnetFar},
                                     {"foreign_field", FaultKind::kForeignField},
                                     {"saturated_sensor", FaultKind::kSaturatedSensor},
                                     {"stuck_sensor", FaultKind::kStuckSensor},
                                     {"stale_sensor", FaultKind::kStaleSensor},
                                     {"lost_messages", FaultKind::kLostMessages}});
    v("start", start, not_negative(Dimension::kTime));
    v("end", end, not_negative(Dimension::kTime));
    v("strength", strength, not_negative());
    v("sensors", sensors, not_negative());
    v("channel", channel);
    v("position", position, any(Dimension::kLength));
    v("moment", moment, any(Dimension::kMagneticMoment));
  }
};

struct VirtualRigScenario {
  std::uint64_t seed = 1;
  double duration = 20;                               // seconds
  std::uint64_t start_utime = 1'700'000'000'000'000;  // of a log; live it is the wall clock's
  // Files that `rig` starts from, relative to the scenario's own folder.
  std::string rig_file;
  std::string camera_file;
  RigConfiguration rig;
  OrganConfiguration organ;
  TrajectoryConfiguration trajectory;
  ImagingConfiguration imaging;
  MagneticsConfiguration magnetics;
  std::vector<FaultConfiguration> faults;

  void check() const;
  template <class Visitor>
  void fields(Visitor& v) {
    v("seed", seed);
    v("duration", duration, positive(Dimension::kTime));
    v("start_utime", start_utime);
    v("rig_file", rig_file);
    v("camera_file", camera_file);
    v.section("rig", rig);
    v.section("organ", organ);
    v.section("trajectory", trajectory);
    v.section("imaging", imaging);
    v.section("magnetics", magnetics);
    v.list("faults", faults);
  }
};

// Throws ConfigurationError.
VirtualRigScenario load_scenario(const std::string& file, const std::vector<std::string>& settings);

}  // namespace gastronaut

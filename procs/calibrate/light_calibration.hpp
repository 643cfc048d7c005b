// Power, lobe and vignetting of the capsule's light and the camera's response, from pictures of a
// flat matte card seen from known (or, but for a turn about the magnet's axis, magnetically known)
// places, or of tissue with known depth.
//
// Robust maximum likelihood: the levels are modelled as light_model.hpp says, with the camera's
// noise and a relative scatter of the light that is estimated along. Unknown with them is the
// card's plane (three numbers) and each picture's pose within its prior, or each place's albedo
// where tissue is looked at: what tells lamp and lens from the tissue is a place seen from several
// sides. Levenberg-Marquardt steps eliminate poses and places one by one (Schur complement).
// Neighbouring pixels and pictures err together; by how much more the pictures pull apart than
// independent pixels would is measured, and the covariance is inflated by it. It does not know of
// the shadows that folds cast, nor of relief that the depth does not show: with tissue, gamma errs
// by a percent or two, lobe + vignetting by up to 0.1, and the power by what the albedo of the
// tissue seen differs from the one assumed. A card has none of that.
#pragma once

#include <Eigen/Core>
#include <array>
#include <functional>
#include <string>
#include <vector>

#include "calibrate/calibration_readings.hpp"
#include "calibrate/light_samples.hpp"
#include "configuration/rig_configuration.hpp"

namespace gastronaut {

struct LightCalibrationOptions {
  double albedo = 0.9;     // of the card, or on average of the tissue; red
  int response_knots = 0;  // of a table instead of gamma; 0: gamma
  bool hold_lobe = false;  // as configured
  bool hold_vignetting = false;
  bool hold_response = false;
};

struct LightCalibration {
  CameraConfiguration camera;  // led_intensity, vignetting_cos_power, gamma or response are new
  LightsConfiguration lights;  // and lobe
  // One sigma; zero of what was held.
  double power_std = 0;  // relative, of led_intensity times albedo
  double lobe_std = 0;
  double vignetting_std = 0;
  double fall_off_std = 0;  // of lobe + vignetting, which alone counts far from the lights
  double gamma_std = 0;     // without a table
  // Of log power, lobe, vignetting, then log gamma or the logarithms of the table's increments.
  Eigen::MatrixXd covariance;
  std::vector<double> response_std;  // of the table
  // What the calibration's uncertainty does to a depth, relative, one sigma: at the picture's
  // middle and near its corner, at each of kDepthsToJudge.
  static constexpr std::array<double, 3> kDepthsToJudge = {0.01, 0.03, 0.06};  // metres
  std::array<double, 3> depth_std_middle{};
  std::array<double, 3> depth_std_corner{};

  int pictures = 0;
  int samples = 0;
  double outliers = 0;        // fraction beyond the robust loss' knee
  double residual_rms = 0;    // grey levels, of the others
  double scatter = 0;         // relative, of light: albedo and whatever the model lacks
  double residual_scale = 0;  // typical residual in units of what noise and scatter explain
  double inflation = 1;       // of the variance, since pixels err together
  double nearest = 0;         // metres along the optical axis, 5th and 95th percentile
  double furthest = 0;
  // Mean residual (relative, of light) by distance, nearest fifth of the samples first: what a
  // wrong model or stray light would show.
  struct Band {
    double from = 0;  // metres
    double to = 0;
    double mean = 0;
  };
  std::vector<Band> bands;
  // What these pictures leave open, weakest first, and what to record to mend it.
  std::vector<std::string> weaknesses;
};

// `counts` is what became of the pixels, for what is said when too few are left. All pictures have
// a pose or none has. progress gets 0..1. Throws CalibrationRefused.
LightCalibration calibrate_light(const RigConfiguration& rig,
                                 const std::vector<LightPicture>& pictures,
                                 const SampleCounts& counts, const LightCalibrationOptions& options,
                                 const std::function<void(double)>& progress);

}  // namespace gastronaut

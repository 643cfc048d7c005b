#include "calibrate/light_report.hpp"

#include <spdlog/fmt/fmt.h>

#include <cmath>

#include "calibrate/calibration_report.hpp"

namespace gastronaut {
namespace {

constexpr double kMilli = 1e3;
constexpr double kPercent = 100;

std::string line(const char* what, double before, double after, const std::string& deviation) {
  return fmt::format("{:<26} {:12.6g} {:12.6g}   {}\n", what, before, after, deviation);
}

std::string plus_minus(bool held, double deviation) {
  return held ? "held" : fmt::format("+-{:.2g}", deviation);
}

}  // namespace

std::string light_table(const LightCalibration& calibration, const RigConfiguration& before,
                        const LightCalibrationOptions& options) {
  std::string text = fmt::format("{:<26} {:>12} {:>12}\n", "", "before", "calibrated");
  text += line("led_intensity, m^2", before.camera.led_intensity, calibration.camera.led_intensity,
               fmt::format("+-{:.2g} %, if the albedo is {:g}", calibration.power_std * kPercent,
                           options.albedo));
  text += line("lobe", before.lights.lobe, calibration.lights.lobe,
               plus_minus(options.hold_lobe, calibration.lobe_std));
  text += line("vignetting_cos_power", before.camera.vignetting_cos_power,
               calibration.camera.vignetting_cos_power,
               plus_minus(options.hold_vignetting, calibration.vignetting_std));
  text += line("lobe + vignetting", before.lights.lobe + before.camera.vignetting_cos_power,
               calibration.lights.lobe + calibration.camera.vignetting_cos_power,
               fmt::format("+-{:.2g}, what counts far from the lights", calibration.fall_off_std));
  if (calibration.camera.response.empty()) {
    text += line("gamma", before.camera.gamma, calibration.camera.gamma,
                 plus_minus(options.hold_response, calibration.gamma_std));
  } else {
    double worst = 0;
    for (const double deviation : calibration.response_std) worst = std::max(worst, deviation);
    text += fmt::format(
        "{:<26} {} levels, {}\n", "response", calibration.camera.response.size(),
        options.hold_response ? "held" : fmt::format("+-{:.2g} of full scale at worst", worst));
  }
  text += fmt::format("{:<26}", "depth errs by, one sigma");
  for (std::size_t i = 0; i < LightCalibration::kDepthsToJudge.size(); ++i) {
    text += fmt::format("{} {:.2f} % at {:.0f} mm (corner {:.2f} %)", i == 0 ? "" : ",",
                        calibration.depth_std_middle[i] * kPercent,
                        LightCalibration::kDepthsToJudge[i] * kMilli,
                        calibration.depth_std_corner[i] * kPercent);
  }
  text += fmt::format("\n{:<26} {} in {} pictures, {:.1f} to {:.1f} mm away\n", "places used",
                      calibration.samples, calibration.pictures, calibration.nearest * kMilli,
                      calibration.furthest * kMilli);
  text += fmt::format(
      "{:<26} {:.2f} grey levels rms, {:.2f} % beyond 4 sigmas; scatter of the albedo {:.2f} %\n",
      "residual", calibration.residual_rms, calibration.outliers * kPercent,
      calibration.scatter * kPercent);
  text += fmt::format("{:<26} {:.2f}, of variances: neighbouring pixels err together\n",
                      "inflation", calibration.inflation);
  text += fmt::format("{:<26}", "mean residual");
  for (std::size_t i = 0; i < calibration.bands.size(); ++i) {
    const LightCalibration::Band& band = calibration.bands[i];
    text += fmt::format("{} {:+.2f} % ({:.0f}-{:.0f} mm)", i == 0 ? "" : ",", band.mean * kPercent,
                        band.from * kMilli, band.to * kMilli);
  }
  text += "\n";
  for (const std::string& weakness : calibration.weaknesses) text += "weak: " + weakness + "\n";
  return text;
}

std::string light_fragment(const LightCalibration& calibration, const RigConfiguration& before,
                           const LightCalibrationOptions& options, const std::string& log) {
  const std::string head =
      fmt::format(
          "Made by `calibrate light` from {}. Give it after the rig's own file: --config "
          "RIG.yaml --config THIS.yaml\nWhat is known is led_intensity times the red albedo of "
          "what "
          "was looked at, here taken as {:g}.\n",
          log, options.albedo) +
      light_table(calibration, before, options);
  YAML::Emitter out;
  FieldWriter writer(out);
  out << YAML::BeginMap << YAML::Key << "camera" << YAML::Value << YAML::BeginMap;
  writer("led_intensity", calibration.camera.led_intensity);
  writer("vignetting_cos_power", calibration.camera.vignetting_cos_power);
  writer("gamma", calibration.camera.gamma);
  writer("response", calibration.camera.response);
  out << YAML::EndMap << YAML::Key << "lights" << YAML::Value << YAML::BeginMap;
  writer("lobe", calibration.lights.lobe);
  out << YAML::EndMap << YAML::EndMap;
  return commented(head) + out.c_str() + "\n";
}

}  // namespace gastronaut

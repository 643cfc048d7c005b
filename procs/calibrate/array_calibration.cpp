#include "calibrate/array_calibration.hpp"

#include <spdlog/fmt/fmt.h>

#include <algorithm>
#include <cmath>

#include "calibrate/magnet_pose_fit.hpp"
#include "calibrate/missing_motion.hpp"
#include "magnetics/axial_magnet.hpp"

namespace gastronaut {
namespace {

// The log is cut into stretches; every fifth is held out, so that the check sees other poses than
// the fit did.
constexpr std::size_t kStretches = 20;
constexpr std::size_t kHeldOutEvery = 5;
constexpr std::size_t kMostHeldOut = 100;
constexpr std::size_t kFewestReadings = 50;
constexpr double kFewestLocated = 0.5;       // of the readings tried
constexpr double kPoorStart = 1.5;           // chi2 per channel, offsets' errors included
constexpr double kPoorFit = 2;               // times the median residual: the magnet is not there
constexpr double kForeignField = 8;          // robust sigmas of the background's scatter
constexpr double kLeastForeignField = 5e-6;  // tesla
constexpr double kFewestInliers = 0.7;       // of the channels
constexpr double kFoundAbove = 4;            // times noise and offset, at the nearest sensor
constexpr double kHeardAbove = 3;            // times the noise: least field a sensor must have seen
constexpr double kLeastImprovement = 0.35;   // of the fix error that the array causes: what is left
constexpr double kLargestResiduals = 3;      // times the configured noise
constexpr double kPoseDisagreement = 0.01;   // metres between given and fitted poses
constexpr int kMostRounds = 3;
constexpr double kClearlyBetter = 4;  // chi2 of a reading
constexpr std::size_t kInducedErrorPoses = 25;
constexpr double kShareOfSearch = 0.2;  // of the progress shown

struct Located {
  std::vector<CalibrationReading> readings;
  std::vector<MagnetPoseFit> fits;
};

std::vector<std::size_t> spread_evenly(const std::vector<std::size_t>& from, std::size_t most) {
  if (from.size() <= most) return from;
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i < most; ++i) chosen.push_back(from[i * from.size() / most]);
  return chosen;
}

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// `least_field`: tesla; a magnet that makes less at every sensor was not found but imagined.
Located locate(const MagnetPoseFitter& fitter, const std::vector<CalibrationReading>& readings,
               const std::vector<std::size_t>& chosen, double least_field,
               const std::function<void(double)>& progress) {
  Located located;
  std::optional<MagnetPose> previous;
  for (std::size_t i = 0; i < chosen.size(); ++i) {
    progress(static_cast<double>(i) / static_cast<double>(chosen.size()));
    const CalibrationReading& reading = readings[chosen[i]];
    const std::optional<MagnetPose>& start = reading.known_pose ? reading.known_pose : previous;
    std::optional<MagnetPoseFit> fit;
    if (start) fit = fitter.fit(reading, start);
    // The magnet may have moved too far for the last pose to lead to this one.
    if (!reading.known_pose && (!fit || fit->chi2_per_channel > kPoorStart)) {
      const auto fresh = fitter.fit(reading, std::nullopt);
      if (fresh && (!fit || fresh->chi2_per_channel < fit->chi2_per_channel)) fit = fresh;
    }
    if (!fit || 1 - fit->outlier_fraction < kFewestInliers || fit->strongest < least_field) {
      previous.reset();
      continue;
    }
    previous = fit->pose;
    located.readings.push_back(reading);
    located.fits.push_back(*fit);
  }
  return located;
}

// Readings whose residual or background stands out have another field in them than magnet, coils
// and the constant background.
Located without_foreign_fields(const Located& all) {
  std::vector<double> residuals;
  for (const MagnetPoseFit& fit : all.fits) residuals.push_back(fit.rms);
  const double usual_residual = median(residuals);
  Eigen::Vector3d usual_background;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    for (const MagnetPoseFit& fit : all.fits) values.push_back(fit.background(axis));
    usual_background(axis) = median(values);
  }
  std::vector<double> departures;
  for (const MagnetPoseFit& fit : all.fits) {
    departures.push_back((fit.background - usual_background).norm());
  }
  constexpr double kMedianOfNormal3 = 1.538;  // median norm of three standard normals
  const double widest =
      std::max(kLeastForeignField, kForeignField * median(departures) / kMedianOfNormal3);
  Located kept;
  for (std::size_t i = 0; i < all.fits.size(); ++i) {
    if (all.fits[i].rms > kPoorFit * usual_residual || departures[i] > widest) continue;
    kept.readings.push_back(all.readings[i]);
    kept.fits.push_back(all.fits[i]);
  }
  return kept;
}

// Residual of single fixes, and how many readings had one.
double rms_of_fixes(const RigConfiguration& rig, const std::vector<CalibrationReading>& readings,
                    const std::vector<MagnetPoseFit>& starts) {
  const MagnetPoseFitter fitter(rig);
  double squares = 0;
  int count = 0;
  for (std::size_t i = 0; i < readings.size(); ++i) {
    const auto fit = fitter.fit(readings[i], starts[i].pose);
    if (!fit) continue;
    squares += fit->rms * fit->rms;
    ++count;
  }
  return count > 0 ? std::sqrt(squares / count) : 0;
}

std::string join(const std::vector<std::string>& sentences) {
  std::string text;
  for (const std::string& sentence : sentences) text += "\n  - " + sentence;
  return text;
}

// Sensors that the magnet never came near enough to.
std::vector<int> unheard_sensors(const RigConfiguration& rig,
                                 const std::vector<Eigen::Vector3d>& positions,
                                 const std::vector<MagnetPoseFit>& fits) {
  const double ratio = octupole_ratio(rig.magnet.shape());
  std::vector<int> unheard;
  for (std::size_t s = 0; s < positions.size(); ++s) {
    double strongest = 0;
    for (const MagnetPoseFit& fit : fits) {
      strongest = std::max(strongest, axial_magnet_field(positions[s] - fit.pose.position,
                                                         rig.magnet.moment * fit.pose.axis, ratio)
                                          .norm());
    }
    if (strongest < kHeardAbove * rig.hall_array.noise) unheard.push_back(static_cast<int>(s));
  }
  return unheard;
}

// Sensor errors can hide the right one of several places that explain a reading. With the sensors
// calibrated it stands out: moves such poses there and returns how many there were.
int mend_poses(const std::vector<CalibrationReading>& readings, JointArrayFit& fit) {
  RigConfiguration calibrated = fit.rig();
  calibrated.hall_array.offset_std = 0;
  const MagnetPoseFitter fitter(calibrated);
  int mended = 0;
  for (std::size_t t = 0; t < readings.size(); ++t) {
    if (readings[t].known_pose) continue;
    const auto here = fitter.fit(readings[t], fit.poses()[t]);
    const auto elsewhere = fitter.fit(readings[t], std::nullopt);
    if (!elsewhere) continue;
    const double gain = kClearlyBetter / static_cast<double>(readings[t].field.size());
    if (here && here->chi2_per_channel < elsewhere->chi2_per_channel + gain) continue;
    fit.move_pose(t, elsewhere->pose);
    ++mended;
  }
  return mended;
}

JointArrayFit::InducedError mean_induced_error(const JointArrayFit& fit, std::size_t readings) {
  JointArrayFit::InducedError mean;
  const std::size_t poses = std::min(kInducedErrorPoses, readings);
  for (std::size_t i = 0; i < poses; ++i) {
    const JointArrayFit::InducedError one = fit.induced_error(i * readings / poses);
    mean.prior_position += one.prior_position * one.prior_position;
    mean.prior_axis += one.prior_axis * one.prior_axis;
    mean.position += one.position * one.position;
    mean.axis += one.axis * one.axis;
  }
  const auto root = [&](double sum) { return std::sqrt(sum / static_cast<double>(poses)); };
  return {root(mean.prior_position), root(mean.prior_axis), root(mean.position), root(mean.axis)};
}

}  // namespace

ArrayCalibration calibrate_array(const RigConfiguration& rig,
                                 const std::vector<CalibrationReading>& readings,
                                 const ArrayCalibrationOptions& options,
                                 const std::function<void(double)>& progress) {
  std::vector<std::size_t> for_fit;
  std::vector<std::size_t> for_check;
  for (std::size_t i = 0; i < readings.size(); ++i) {
    const std::size_t stretch = i * kStretches / readings.size();
    (stretch % kHeldOutEvery == kHeldOutEvery - 1 ? for_check : for_fit).push_back(i);
  }
  if (for_fit.size() < kFewestReadings) {
    throw CalibrationRefused(fmt::format(
        "the log has {} usable array readings; at least {} are needed: record for longer",
        readings.size(), kFewestReadings * kHeldOutEvery / (kHeldOutEvery - 1)));
  }
  const auto chosen = spread_evenly(for_fit, static_cast<std::size_t>(options.most_readings));
  RigConfiguration before = rig;
  before.hall_array.offset_std = options.priors.offset_std;
  const MagnetPoseFitter fitter(before);
  const double least_field =
      kFoundAbove * std::hypot(rig.hall_array.noise, options.priors.offset_std);
  const Located found = locate(fitter, readings, chosen, least_field,
                               [&](double fraction) { progress(kShareOfSearch * fraction); });
  const Located used = found.fits.empty() ? found : without_foreign_fields(found);
  const auto fewest = std::max(static_cast<double>(kFewestReadings),
                               kFewestLocated * static_cast<double>(chosen.size()));
  if (static_cast<double>(used.fits.size()) < fewest) {
    throw CalibrationRefused(fmt::format(
        "the magnet was found in only {} of {} readings: is it within reach of the array, is "
        "another magnet near, are magnet.moment and the array's geometry configured as they are?",
        used.fits.size(), chosen.size()));
  }
  std::vector<double> disagreements;
  std::vector<MagnetPose> starts;
  for (std::size_t i = 0; i < used.fits.size(); ++i) {
    const auto& known = used.readings[i].known_pose;
    starts.push_back(known ? *known : used.fits[i].pose);
    disagreements.push_back((starts.back().position - used.fits[i].pose.position).norm());
  }
  if (median(disagreements) > kPoseDisagreement) {
    throw CalibrationRefused(fmt::format(
        "the known poses lie {:.0f} mm from where the array sees the magnet: is camera_T_magnet "
        "right, and are the poses those of the camera in the rig frame? --poses unknown calibrates "
        "without them",
        median(disagreements) * 1e3));
  }
  std::vector<Eigen::Vector3d> positions;
  for (const auto& sensor : rig.hall_array.resolved_sensors()) positions.push_back(sensor.position);
  const std::vector<int> unheard = unheard_sensors(rig, positions, used.fits);
  if (!unheard.empty()) {
    throw CalibrationRefused(
        fmt::format("{} never saw more than {:.2g} uT of the magnet: move it under {}",
                    name_sensors(unheard, positions), kHeardAbove * rig.hall_array.noise * 1e6,
                    unheard.size() == 1 ? "it" : "them"));
  }

  JointArrayFit fit(rig, options.priors, used.readings, starts);
  bool converged = false;
  for (int round = 0; round < kMostRounds; ++round) {
    converged = fit.solve(
        [&](double fraction) { progress(kShareOfSearch + (1 - kShareOfSearch) * fraction); });
    if (!converged || mend_poses(used.readings, fit) == 0) break;
  }
  const double residual_scale = fit.residual_scale();
  if (residual_scale > kLargestResiduals) {
    throw CalibrationRefused(fmt::format(
        "magnet, coils and a constant background do not explain the readings: residuals are {:.1f} "
        "times the configured noise of {:.2g} uT. Is hall_array.noise right, did the background "
        "change, was other iron or another magnet moved near, are the magnet's dimensions right?",
        residual_scale, rig.hall_array.noise * 1e6));
  }
  if (!converged) {
    throw CalibrationRefused(
        "the joint fit of poses and sensors did not converge: are magnet and array configured as "
        "they are?");
  }
  ArrayCalibration result;
  result.chi2_per_dof = fit.chi2_per_dof();
  const double inflation = std::sqrt(std::max(1.0, result.chi2_per_dof));
  result.induced = mean_induced_error(fit, used.readings.size());
  result.induced.position *= inflation;
  result.induced.axis *= inflation;
  if (result.induced.position > kLeastImprovement * result.induced.prior_position ||
      result.induced.axis > kLeastImprovement * result.induced.prior_axis) {
    std::vector<std::string> missing = describe_missing_motion(starts, positions);
    if (missing.empty()) {
      missing.push_back(
          "no motion is missing altogether, but there is too little of each: move "
          "nearer to the array and record for longer");
    }
    throw CalibrationRefused(fmt::format(
        "the log does not determine the array: a fix would still err by {:.2f} mm and {:.2f} "
        "degrees for the array's sake, against {:.2f} mm and {:.2f} degrees without calibration.{}",
        result.induced.position * 1e3, result.induced.axis * 180 / M_PI,
        result.induced.prior_position * 1e3, result.induced.prior_axis * 180 / M_PI,
        join(missing)));
  }

  result.rig = fit.rig();
  result.background = fit.background();
  result.readings_used = static_cast<int>(used.fits.size());
  result.readings_left_out = static_cast<int>(chosen.size() - used.fits.size());
  result.deviations = fit.channel_deviations();
  double gain = 0;
  double alignment = 0;
  double offset = 0;
  for (JointArrayFit::ChannelDeviation& channel : result.deviations) {
    channel.gain *= inflation;
    channel.alignment *= inflation;
    channel.offset *= inflation;
    gain += channel.gain * channel.gain;
    alignment += channel.alignment * channel.alignment;
    offset += channel.offset * channel.offset;
  }
  const auto channels = static_cast<double>(result.deviations.size());
  result.rig.hall_array.gain_std = std::sqrt(gain / channels);
  result.rig.hall_array.alignment_std = std::sqrt(alignment / channels);
  result.rig.hall_array.offset_std = std::sqrt(offset / channels);
  result.rig.magnet.moment_std = fit.moment_deviation() * inflation;

  const Located held_out =
      locate(fitter, readings, spread_evenly(for_check, kMostHeldOut), least_field, [](double) {});
  const Located check = held_out.fits.empty() ? held_out : without_foreign_fields(held_out);
  result.held_out = static_cast<int>(check.fits.size());
  result.held_out_rms_before = rms_of_fixes(rig, check.readings, check.fits);
  result.held_out_rms_after = rms_of_fixes(result.rig, check.readings, check.fits);
  return result;
}

}  // namespace gastronaut

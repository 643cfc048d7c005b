#include "calibrate/light_calibration.hpp"

#include <spdlog/fmt/fmt.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>

#include "calibrate/light_fit.hpp"
#include "calibrate/robust_weight.hpp"
#include "camera/camera_model.hpp"
#include "photometry/near_light.hpp"

namespace gastronaut {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr std::size_t kFewestPictures = 5;
constexpr std::int64_t kFewestSamples = 500;
// One sigma of what is believed before the pictures are seen: next to nothing.
constexpr double kPowerPrior = 3;       // of the logarithm
constexpr double kExponentPrior = 0.5;  // of lobe and vignetting
constexpr double kGammaPrior = 0.5;     // of the logarithm
constexpr double kTablePrior = 0.5;     // of an increment's logarithm, about gamma's
constexpr double kTableBend = 50;       // of its second difference, over the knots squared
constexpr double kHeld = 1e-6;
// Where the card is looked for.
constexpr double kNearestCard = 0.004;  // metres from the first picture's camera
constexpr double kFurthestCard = 0.15;
constexpr double kDistanceStep = 1.25;
constexpr std::array<double, 3> kTilts = {0, 25 * kDegree, 50 * kDegree};
constexpr int kTiltDirections = 8;
constexpr std::size_t kStarts = 4;
constexpr std::size_t kSparsePictures = 24;
constexpr std::size_t kSparseSamples = 6;  // one in so many
constexpr double kShareOfSearch = 0.4;     // of the progress shown
// What is not good enough.
constexpr double kLeastRangeOfLight = 1.5;  // of exposure / distance^2, 95th over 5th percentile
constexpr double kWorstCard = 0.1;          // scatter; light on a flat matte card is known better
constexpr double kPoorPower = 0.01;         // one sigma, relative, that is worth a word
constexpr double kPoorExponent = 0.1;       // of lobe or vignetting
constexpr double kPoorGamma = 0.01;         // relative
constexpr double kCloseUp = 0.015;          // metres: from here lobe and vignetting look different
constexpr double kLowest = 0.05;            // fraction of the samples
constexpr double kCorner = 0.1;             // of the picture's size from its border
constexpr std::size_t kBands = 5;

double fraction_of(std::vector<double> values, double fraction) {
  const auto place = static_cast<std::ptrdiff_t>(fraction * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), values.begin() + place, values.end());
  return values[static_cast<std::size_t>(place)];
}

double squared(double value) { return value * value; }

void refuse_too_few(const std::vector<LightPicture>& pictures, const SampleCounts& counts) {
  if (counts.used < kFewestSamples) {
    struct Reason {
      std::int64_t count;
      const char* text;
    };
    const std::array<Reason, 5> reasons = {
        {{counts.saturated,
          "are saturated: shorten the exposure, dim the lamps or go further away"},
         {counts.dark,
          "are black or nearly so: are the lamps on? Lengthen the exposure or go nearer"},
         {counts.without_ray, "lie where the camera's calibration says that the lens sees nothing"},
         {counts.without_depth, "have no depth"},
         {counts.unsuitable,
          "lie on edges, are seen at a grazing angle, or may carry highlights"}}};
    const Reason& worst =
        *std::max_element(reasons.begin(), reasons.end(),
                          [](const Reason& a, const Reason& b) { return a.count < b.count; });
    throw CalibrationRefused(
        fmt::format("only {} of {} places in {} pictures tell anything of the light; {} {}",
                    counts.used, counts.total(), pictures.size(), worst.count, worst.text));
  }
  if (pictures.size() < kFewestPictures) {
    throw CalibrationRefused(
        fmt::format("the log has {} usable pictures with known geometry; at least {} are needed, "
                    "some tens are better",
                    pictures.size(), kFewestPictures));
  }
}

// As configured; the light's power such that the card's albedo is what it is.
LightParameters configured(const RigConfiguration& rig, const LightCalibrationOptions& options) {
  LightParameters start;
  start.log_power = std::log(rig.camera.led_intensity * options.albedo);
  start.lobe = rig.lights.lobe;
  start.vignetting = rig.camera.vignetting_cos_power;
  if (rig.camera.response.empty()) {
    start.response = ResponseCurve::with_gamma(rig.camera.gamma);
    return start;
  }
  start.response = ResponseCurve::with_table(rig.camera.response);
  if (options.hold_response) return start;
  // The power law that agrees with the table at half level.
  start.response = ResponseCurve::with_gamma(std::log(start.response.light(0.5)) / std::log(0.5));
  return start;
}

Eigen::MatrixXd prior_information(const LightParameters& start,
                                  const LightCalibrationOptions& options) {
  const Eigen::Index num_response = start.response.num_parameters();
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(3 + num_response, 3 + num_response);
  information(0, 0) = 1 / squared(kPowerPrior);
  information(1, 1) = 1 / squared(options.hold_lobe ? kHeld : kExponentPrior);
  information(2, 2) = 1 / squared(options.hold_vignetting ? kHeld : kExponentPrior);
  auto response = information.bottomRightCorner(num_response, num_response);
  const double prior = options.hold_response       ? kHeld
                       : start.response.is_table() ? kTablePrior
                                                   : kGammaPrior;
  response.diagonal().setConstant(1 / squared(prior));
  const double bend = kTableBend / squared(static_cast<double>(num_response));
  for (Eigen::Index k = 1; k + 1 < num_response; ++k) {
    Eigen::VectorXd difference = Eigen::VectorXd::Zero(num_response);
    difference.segment<3>(k - 1) = Eigen::Vector3d(1, -2, 1);
    response += difference * difference.transpose() / squared(bend);
  }
  return information;
}

std::vector<LightPicture> thinned(const std::vector<LightPicture>& pictures) {
  std::vector<LightPicture> result;
  const std::size_t stride = std::max<std::size_t>(1, pictures.size() / kSparsePictures);
  for (std::size_t f = 0; f < pictures.size(); f += stride) {
    result.push_back({pictures[f].exposure, {}, pictures[f].pose});
    for (std::size_t i = f % kSparseSamples; i < pictures[f].samples.size(); i += kSparseSamples) {
      result.back().samples.push_back(pictures[f].samples[i]);
    }
  }
  return result;
}

// The card's plane, found by trying all distances and tilts and fitting from the best of them.
Eigen::Vector3d find_card(const std::vector<LightPicture>& pictures,
                          const std::vector<Eigen::Vector3d>& lights, const LightFit::Noise& noise,
                          const LightParameters& start, const Eigen::MatrixXd& information,
                          const std::function<void(double)>& progress) {
  const std::vector<LightPicture> few = thinned(pictures);
  LightFit fit(few, lights, noise, start, information);
  Eigen::Vector3d ahead = Eigen::Vector3d::Zero();
  for (const LightPicture& picture : few) {
    ahead += picture.pose->rig_T_camera.rotation * Eigen::Vector3d::UnitZ();
  }
  ahead.normalize();
  const Eigen::Matrix<double, 3, 2> across = perpendicular_basis(ahead);
  struct Candidate {
    double misfit;
    Eigen::Vector3d card;
  };
  std::vector<Candidate> candidates;
  for (double distance = kNearestCard; distance < kFurthestCard; distance *= kDistanceStep) {
    for (const double tilt : kTilts) {
      for (int k = 0; k < (tilt > 0 ? kTiltDirections : 1); ++k) {
        const double turn = 2 * std::numbers::pi * k / kTiltDirections;
        const Eigen::Vector3d direction =
            std::cos(tilt) * ahead +
            std::sin(tilt) * across * Eigen::Vector2d(std::cos(turn), std::sin(turn));
        const Eigen::Vector3d card = direction / distance;
        candidates.push_back({fit.misfit(card), card});
      }
    }
    progress(0.5 * std::log(distance / kNearestCard) / std::log(kFurthestCard / kNearestCard));
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const Candidate& a, const Candidate& b) { return a.misfit < b.misfit; });
  Eigen::Vector3d best = candidates.front().card;
  double least_scatter = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < kStarts; ++i) {
    fit.start_from(candidates[i].card);
    if (fit.solve([](double) {}) && fit.scatter() + fit.residual_scale() < least_scatter) {
      least_scatter = fit.scatter() + fit.residual_scale();
      best = fit.parameters().card;
    }
    progress(0.5 + 0.5 * static_cast<double>(i + 1) / kStarts);
  }
  return best;
}

// One sigma of the relative light that a calibration expects from a wall seen face on.
double light_std(const LightFit& fit, const std::vector<Eigen::Vector3d>& lights,
                 const Eigen::Vector3d& ray, double depth) {
  const LightParameters& parameters = fit.parameters();
  const Eigen::Vector3d plane(0, 0, 1 / depth);
  const Shading middle = shade(Eigen::Vector3d::UnitZ(), plane, lights, parameters.lobe);
  const Shading here = shade(ray, plane, lights, parameters.lobe);
  // The exposure is such that the picture's middle has half level.
  const double light =
      parameters.response.light(0.5) *
      std::exp(here.log_light - middle.log_light - parameters.vignetting * std::log(ray.norm()));
  Eigen::VectorXd row = Eigen::VectorXd::Zero(fit.covariance().rows());
  const auto level = parameters.response.level(light, row.data() + 3);
  row.segment(3, parameters.response.num_parameters()) /= level.slope * light;
  row(0) = 1;
  row(1) = here.by_lobe;
  row(2) = -std::log(ray.norm());
  return std::sqrt(row.dot(fit.covariance() * row));
}

ResponseCurve tabulated(const ResponseCurve& response, int knots) {
  std::vector<double> table;
  for (int k = 0; k < knots; ++k) {
    table.push_back(response.light(static_cast<double>(k) / (knots - 1)));
  }
  return ResponseCurve::with_table(table);
}

std::vector<double> table_std(const ResponseCurve& response, const Eigen::MatrixXd& covariance) {
  const Eigen::Index count = response.num_parameters();
  const Eigen::MatrixXd of_response = covariance.block(3, 3, count, count);
  std::vector<double> deviations;
  for (const double light : response.table()) {
    // The light of this level changes by what its level would, over the slope.
    Eigen::VectorXd row(count);
    const auto level = response.level(light, row.data());
    row /= level.slope;
    deviations.push_back(std::sqrt(std::max(0.0, row.dot(of_response * row))));
  }
  return deviations;
}

// Sets nearest and furthest. Refuses pictures whose light differs too little for a response.
void find_range(const std::vector<LightPicture>& pictures,
                const std::vector<LightFit::Residual>& residuals,
                const LightCalibrationOptions& options, LightCalibration& result) {
  if (residuals.empty()) return;
  std::vector<double> depths;
  std::vector<double> lights;
  for (const LightFit::Residual& residual : residuals) {
    depths.push_back(residual.depth);
    lights.push_back(pictures[residual.picture].exposure / squared(residual.depth));
  }
  result.nearest = fraction_of(depths, kLowest);
  result.furthest = fraction_of(depths, 1 - kLowest);
  const double range = fraction_of(lights, 1 - kLowest) / fraction_of(lights, kLowest);
  if (options.hold_response || range >= kLeastRangeOfLight) return;
  throw CalibrationRefused(fmt::format(
      "the pictures are all from {:.0f} to {:.0f} mm at one exposure: the camera's response cannot "
      "be told from the light's power. Add pictures from other distances, 10 to 40 mm say, or give "
      "--hold response if the configured one can be trusted",
      result.nearest * 1e3, result.furthest * 1e3));
}

void judge_residuals(std::vector<LightFit::Residual> residuals, LightCalibration& result) {
  double squares = 0;
  int outliers = 0;
  for (const LightFit::Residual& residual : residuals) {
    if (std::abs(residual.sigmas) > kRobustKnee) {
      ++outliers;
    } else {
      squares += squared(residual.level * 255);
    }
  }
  result.samples = static_cast<int>(residuals.size());
  result.outliers = static_cast<double>(outliers) / result.samples;
  result.residual_rms = std::sqrt(squares / std::max(1, result.samples - outliers));
  std::stable_sort(residuals.begin(), residuals.end(),
                   [](const auto& a, const auto& b) { return a.depth < b.depth; });
  for (std::size_t band = 0; band < kBands; ++band) {
    const std::size_t begin = band * residuals.size() / kBands;
    const std::size_t end = (band + 1) * residuals.size() / kBands;
    LightCalibration::Band of_band{residuals[begin].depth, residuals[end - 1].depth, 0};
    double count = 0;
    for (std::size_t i = begin; i < end; ++i) {
      if (std::abs(residuals[i].sigmas) > kRobustKnee) continue;
      of_band.mean += residuals[i].relative;
      ++count;
    }
    of_band.mean /= std::max(1.0, count);
    result.bands.push_back(of_band);
  }
}

// Light falls with the square of the distance: half its relative error is the depth's.
void judge_depth(const LightFit& fit, const std::vector<Eigen::Vector3d>& lights,
                 const CameraModel& camera, LightCalibration& result) {
  const Eigen::Vector2d corner(kCorner * camera.intrinsics().width,
                               kCorner * camera.intrinsics().height);
  const Eigen::Vector3d ray = camera.unproject(corner).value_or(Eigen::Vector3d::UnitZ());
  for (std::size_t i = 0; i < LightCalibration::kDepthsToJudge.size(); ++i) {
    const double depth = LightCalibration::kDepthsToJudge[i];
    result.depth_std_middle[i] = light_std(fit, lights, Eigen::Vector3d::UnitZ(), depth) / 2;
    result.depth_std_corner[i] = light_std(fit, lights, ray / ray.z(), depth) / 2;
  }
}

void describe_weaknesses(const LightCalibrationOptions& options, LightCalibration& result) {
  const std::string range =
      fmt::format("{:.0f} to {:.0f} mm", result.nearest * 1e3, result.furthest * 1e3);
  if (!options.hold_lobe && !options.hold_vignetting &&
      std::max(result.lobe_std, result.vignetting_std) > kPoorExponent &&
      result.fall_off_std < 0.5 * std::max(result.lobe_std, result.vignetting_std)) {
    result.weaknesses.push_back(fmt::format(
        "lobe and vignetting cannot be told apart from these pictures (each +-{:.2f}, their sum "
        "+-{:.3f}): add pictures closer than {:.0f} mm (these are from {}), or hold one of them",
        std::max(result.lobe_std, result.vignetting_std), result.fall_off_std, kCloseUp * 1e3,
        range));
  }
  if (result.fall_off_std > kPoorExponent) {
    result.weaknesses.push_back(
        fmt::format("the fall-off towards the picture's border is known to +-{:.2f} only: add "
                    "pictures that the card fills up to the corners",
                    result.fall_off_std));
  }
  if (!options.hold_response && options.response_knots == 0 &&
      result.gamma_std > kPoorGamma * result.camera.gamma) {
    result.weaknesses.push_back(
        fmt::format("gamma is known to +-{:.3f} only: add pictures from other distances (these are "
                    "from {}; a factor of three is good) or at other exposures",
                    result.gamma_std, range));
  }
  if (result.power_std > kPoorPower) {
    result.weaknesses.push_back(fmt::format(
        "the power is known to +-{:.1f} % only: add pictures, and from other distances (these are "
        "from {})",
        result.power_std * 100, range));
  }
}

}  // namespace

LightCalibration calibrate_light(const RigConfiguration& rig,
                                 const std::vector<LightPicture>& pictures,
                                 const SampleCounts& counts, const LightCalibrationOptions& options,
                                 const std::function<void(double)>& progress) {
  refuse_too_few(pictures, counts);
  const std::vector<Eigen::Vector3d> lights = NearLight(rig.camera, rig.lights).positions();
  const LightFit::Noise noise = {rig.camera.read_noise, rig.camera.shot_noise};
  const bool has_card = pictures.front().pose.has_value();
  LightParameters start = configured(rig, options);
  LightCalibrationOptions held = options;
  if (has_card) {
    start.card = find_card(pictures, lights, noise, start, prior_information(start, options),
                           [&](double done) { progress(kShareOfSearch * done); });
  }
  const bool wants_table = options.response_knots > 0 && !options.hold_response;
  double reached = kShareOfSearch;
  const double share = (1 - kShareOfSearch) / (wants_table ? 2 : 1);
  std::unique_ptr<LightFit> fit;
  const auto solve = [&] {
    fit =
        std::make_unique<LightFit>(pictures, lights, noise, start, prior_information(start, held));
    fit->start_from(start.card);
    return fit->solve([&](double done) { progress(reached + share * done); });
  };
  bool converged = solve();
  // No light shines more to the side than ahead, and no lens sees better there: what came out below
  // zero is zero.
  if (converged && std::min(fit->parameters().lobe, fit->parameters().vignetting) < 0) {
    const bool lobe = fit->parameters().lobe < fit->parameters().vignetting;
    (lobe ? start.lobe : start.vignetting) = 0;
    (lobe ? held.hold_lobe : held.hold_vignetting) = true;
    converged = solve();
  }
  if (converged && wants_table) {
    // A table starts from the power law that fits best.
    start = fit->parameters();
    start.response = tabulated(start.response, options.response_knots);
    reached += share;
    converged = solve();
  }
  LightCalibration result;
  if (held.hold_lobe != options.hold_lobe) {
    result.weaknesses.push_back(
        "the lobe came out below zero and was held at zero: all fall-off "
        "towards the border counts as vignetting");
  }
  if (held.hold_vignetting != options.hold_vignetting) {
    result.weaknesses.push_back(
        "vignetting came out below zero and was held at zero: all fall-off "
        "towards the border counts as the lobe's");
  }
  const std::vector<LightFit::Residual> residuals = fit->residuals();
  find_range(pictures, residuals, options, result);
  if (!converged || static_cast<std::int64_t>(residuals.size()) < kFewestSamples ||
      (has_card && fit->scatter() > kWorstCard)) {
    throw CalibrationRefused(fmt::format(
        "the pictures do not fit {} in the capsule's light alone{}: switch every other light off, "
        "see that {}, and that the configuration's LED positions and camera are right",
        has_card ? "a flat matte card" : "tissue of known depth",
        converged ? fmt::format(" (light differs by {:.0f} %)", fit->scatter() * 100) : "",
        has_card ? "the card fills the pictures and stays where it is, and the poses are right"
                 : "depth and pictures belong together"));
  }
  const LightParameters& found = fit->parameters();
  const Eigen::MatrixXd& covariance = fit->covariance();
  const Eigen::Index num_light = 3 + found.response.num_parameters();
  result.covariance = covariance.topLeftCorner(num_light, num_light);
  result.camera = rig.camera;
  result.lights = rig.lights;
  result.camera.led_intensity = std::exp(found.log_power) / options.albedo;
  result.camera.vignetting_cos_power = std::max(0.0, found.vignetting);
  result.lights.lobe = std::max(0.0, found.lobe);  // held at zero it still moves by next to nothing
  result.power_std = std::sqrt(covariance(0, 0));
  result.lobe_std = held.hold_lobe ? 0 : std::sqrt(covariance(1, 1));
  result.vignetting_std = held.hold_vignetting ? 0 : std::sqrt(covariance(2, 2));
  result.fall_off_std =
      std::sqrt(std::max(0.0, covariance(1, 1) + covariance(2, 2) + 2 * covariance(1, 2)));
  if (found.response.is_table()) {
    result.camera.response = found.response.table();
    result.response_std = table_std(found.response, covariance);
  } else {
    result.camera.gamma = found.response.gamma();
    result.camera.response.clear();
    result.gamma_std =
        options.hold_response ? 0 : found.response.gamma() * std::sqrt(covariance(3, 3));
  }
  result.pictures = static_cast<int>(pictures.size());
  result.scatter = fit->scatter();
  result.residual_scale = fit->residual_scale();
  result.inflation = fit->inflation();
  judge_residuals(residuals, result);
  judge_depth(*fit, lights, CameraModel(rig.camera.intrinsics()), result);
  describe_weaknesses(held, result);
  return result;
}

}  // namespace gastronaut

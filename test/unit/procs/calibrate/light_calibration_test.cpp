#include "calibrate/light_calibration.hpp"

#include <gmock/gmock.h>

#include <cmath>

#include "calibrate/light_report.hpp"
#include "light_simulation.hpp"
#include "numerics/counter_random.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut {
namespace {

using testing::AllOf;
using testing::HasSubstr;

// What the light is configured to be; the true one is 20 % stronger and narrower, the lens darkens
// more, the camera is flatter.
RigConfiguration configured() {
  RigConfiguration rig;
  rig.camera.exposure_gain = 0.15;
  rig.camera.gamma = 2.2;
  rig.camera.read_noise = 0.003;
  rig.camera.shot_noise = 0.015;
  return rig;
}
RigConfiguration true_light() {
  RigConfiguration rig = configured();
  rig.camera.led_intensity *= 1.2;
  rig.lights.lobe = 1.6;
  rig.camera.vignetting_cos_power = 1.5;
  rig.camera.gamma = 2.0;
  return rig;
}

LightCalibration calibrate(const std::vector<LightPicture>& pictures, const SampleCounts& counts,
                           const LightCalibrationOptions& options = {}) {
  return calibrate_light(configured(), pictures, counts, options, [](double) {});
}

LightCalibration calibrate(const SimulatedPictures& run,
                           const LightCalibrationOptions& options = {}) {
  SampleCounts counts;
  const auto pictures = simulate_pictures(true_light(), {}, run, counts);
  return calibrate(pictures, counts, options);
}

std::string refusal(const std::vector<LightPicture>& pictures, const SampleCounts& counts) {
  try {
    calibrate(pictures, counts);
  } catch (const CalibrationRefused& refused) {
    return refused.what();
  }
  return "accepted";
}
std::string refusal(const SimulatedPictures& run, const RigConfiguration& truth = true_light()) {
  SampleCounts counts;
  const auto pictures = simulate_pictures(truth, {}, run, counts);
  return refusal(pictures, counts);
}

// Of log power, lobe, vignetting, log gamma.
Eigen::Vector4d errors_of(const LightCalibration& found) {
  const RigConfiguration truth = true_light();
  return {std::log(found.camera.led_intensity / truth.camera.led_intensity),
          found.lights.lobe - truth.lights.lobe,
          found.camera.vignetting_cos_power - truth.camera.vignetting_cos_power,
          std::log(found.camera.gamma / truth.camera.gamma)};
}

TEST(LightCalibration, FindsTheLightExactlyFromExactPicturesOfACardAtAnUnknownPlace) {
  SimulatedPictures run;
  run.noisy = false;
  run.poses_err = false;
  RigConfiguration without_noise = configured();
  without_noise.camera.read_noise = without_noise.camera.shot_noise = 0;
  SampleCounts counts;
  const auto pictures = simulate_pictures(true_light(), {}, run, counts);
  const LightCalibration found =
      calibrate_light(without_noise, pictures, counts, {}, [](double) {});
  // Weak priors pull by their weight beside the pictures': far less than this.
  constexpr double kExact = 1e-4;
  EXPECT_LT(errors_of(found).cwiseAbs().maxCoeff(), kExact) << errors_of(found).transpose();
  EXPECT_LT(found.residual_rms, kExact);
  EXPECT_TRUE(found.weaknesses.empty()) << found.weaknesses.front();
}

TEST(LightCalibration, ErrorsOverSeedsAreWhatTheCovarianceSays) {
  constexpr int kSeeds = 30;
  double squares = 0;
  Eigen::Vector4d worst = Eigen::Vector4d::Zero();
  for (int seed = 0; seed < kSeeds; ++seed) {
    SimulatedPictures run;
    run.seed = static_cast<std::uint64_t>(seed) + 1;
    const LightCalibration found = calibrate(run);
    const Eigen::Vector4d errors = errors_of(found);
    squares += errors.dot(found.covariance.ldlt().solve(errors));
    worst = worst.cwiseMax(errors.cwiseAbs());
    EXPECT_NEAR(found.power_std, std::sqrt(found.covariance(0, 0)), 1e-12);
  }
  std::printf("worst of %d: power %.2f %%, lobe %.3f, vignetting %.3f, gamma %.2f %%; NEES %.2f\n",
              kSeeds, worst(0) * 100, worst(1), worst(2), worst(3) * 100, squares / (4 * kSeeds));
  // 99 % band of chi-squared with 120 degrees of freedom.
  EXPECT_GT(squares, 83.9);
  EXPECT_LT(squares, 163.6);
  constexpr double kWithin = 0.01;  // of the power: what a lab needs
  EXPECT_LT(worst(0), kWithin);
}

TEST(LightCalibration, MagneticPosesServeAlthoughTheRollIsUnknown) {
  SimulatedPictures run;
  run.position_std = 3e-4;
  run.angle_std = 5e-3;
  SampleCounts counts;
  auto pictures = simulate_pictures(true_light(), {}, run, counts);
  SE3 camera_T_magnet;
  camera_T_magnet.translation = {0.001, -0.0005, -0.009};
  camera_T_magnet.rotation = so3_exp({0.05, -0.03, 0});
  Matrix5d covariance = Matrix5d::Zero();
  covariance.diagonal().head<3>().setConstant(run.position_std * run.position_std);
  covariance.diagonal().tail<2>().setConstant(run.angle_std * run.angle_std);
  for (LightPicture& picture : pictures) {
    const SE3 rig_T_magnet = picture.pose->rig_T_camera * camera_T_magnet;
    picture.pose =
        pose_from_magnet(rig_T_magnet.translation, rig_T_magnet.rotation * Eigen::Vector3d::UnitZ(),
                         covariance, camera_T_magnet, 1e-6, 1e-6);
  }
  const LightCalibration found = calibrate(pictures, counts);
  const Eigen::Vector4d errors = errors_of(found);
  constexpr double kChi2 = 18.5;  // 99.9 % of four degrees of freedom
  EXPECT_LT(errors.dot(found.covariance.ldlt().solve(errors)), kChi2);
  constexpr double kWithin = 0.02;  // relative: poses three times worse than a stage's
  EXPECT_LT(std::abs(errors(0)), kWithin);
}

TEST(LightCalibration, ATableFindsAResponseThatIsNoPowerLaw) {
  SimulatedPictures run;
  // A toe and a shoulder: light of a level is a blend of powers.
  const auto light_of = [](double level) {
    return 0.6 * std::pow(level, 1.6) + 0.4 * std::pow(level, 3.5);
  };
  run.response = [&](double light) {
    double low = 0;
    double high = 1.2;
    for (int i = 0; i < 60; ++i) {
      const double middle = (low + high) / 2;
      (light_of(middle) < light ? low : high) = middle;
    }
    return low;
  };
  LightCalibrationOptions options;
  options.response_knots = 33;
  const LightCalibration found = calibrate(run, options);
  ASSERT_EQ(found.camera.response.size(), 33U);
  EXPECT_EQ(found.camera.response.front(), 0);
  EXPECT_EQ(found.camera.response.back(), 1);
  // Where the levels of the pictures lie. Full scale is where the table ends, which is beyond what
  // unsaturated pictures show: a common factor goes to the power.
  const double scale = found.camera.response[24] / light_of(24.0 / 32);
  constexpr double kOfTable = 0.01;
  for (std::size_t k = 5; k <= 30; ++k) {
    const double expected = light_of(static_cast<double>(k) / 32);
    EXPECT_NEAR(found.camera.response[k] / scale, expected, kOfTable * expected) << "level " << k;
  }
  constexpr double kOfScale = 0.03;
  EXPECT_NEAR(scale, 1, kOfScale);
  EXPECT_NEAR(found.camera.led_intensity / scale, true_light().camera.led_intensity,
              kOfTable * true_light().camera.led_intensity);
  // A power law cannot do that, and its residuals say so.
  EXPECT_GT(calibrate(run).residual_rms, 2 * found.residual_rms);
}

TEST(LightCalibration, SpotsAndShadowsOnTheCardDoNotPull) {
  SimulatedPictures run;
  SampleCounts counts;
  auto pictures = simulate_pictures(true_light(), {}, run, counts);
  const CounterRandom random(3, 0);
  std::uint64_t n = 0;
  constexpr double kSpoilt = 0.05;  // of the samples
  for (LightPicture& picture : pictures) {
    for (LightSample& sample : picture.samples) {
      if (random.uniform(n++) > kSpoilt) continue;
      sample.level = 0.1 + 0.8 * random.uniform(n++);
    }
  }
  const LightCalibration found = calibrate(pictures, counts);
  constexpr double kWithin = 0.01;
  EXPECT_LT(std::abs(errors_of(found)(0)), kWithin);
  EXPECT_NEAR(found.outliers, kSpoilt, 0.2 * kSpoilt);
}

TEST(LightCalibration, OnlyTheProductOfPowerAndAlbedoIsKnown) {
  LightCalibrationOptions darker;
  darker.albedo = 0.45;
  const LightCalibration white = calibrate(SimulatedPictures());
  const LightCalibration grey = calibrate(SimulatedPictures(), darker);
  constexpr double kSame = 1e-4;  // relative; priors and iterations differ a little
  EXPECT_NEAR(grey.camera.led_intensity, 2 * white.camera.led_intensity,
              kSame * grey.camera.led_intensity);
}

TEST(LightCalibration, SaysThatLobeAndVignettingCannotBeToldApartFromAfar) {
  SimulatedPictures run;
  run.nearest = 0.03;
  run.furthest = 0.09;
  RigConfiguration truth = true_light();
  truth.camera.exposure_gain = 1.5;
  RigConfiguration rig = configured();
  rig.camera.exposure_gain = 1.5;
  SampleCounts counts;
  const auto pictures = simulate_pictures(truth, {}, run, counts);
  const LightCalibration found = calibrate_light(rig, pictures, counts, {}, [](double) {});
  ASSERT_FALSE(found.weaknesses.empty());
  EXPECT_THAT(found.weaknesses.front(), AllOf(HasSubstr("lobe and vignetting cannot be told apart"),
                                              HasSubstr("add pictures closer than 15 mm")));
  // Their sum is well known, and right.
  constexpr double kSum = 0.05;
  EXPECT_LT(found.fall_off_std, kSum);
  EXPECT_NEAR(found.lights.lobe + found.camera.vignetting_cos_power, 1.6 + 1.5,
              4 * found.fall_off_std);
  EXPECT_THAT(light_table(found, rig, {}), HasSubstr("weak: lobe and vignetting"));
}

TEST(LightCalibration, WhatIsHeldStaysAsConfigured) {
  LightCalibrationOptions options;
  options.hold_vignetting = true;
  const LightCalibration found = calibrate(SimulatedPictures(), options);
  EXPECT_NEAR(found.camera.vignetting_cos_power, configured().camera.vignetting_cos_power, 1e-4);
  EXPECT_EQ(found.vignetting_std, 0);
  EXPECT_GT(std::abs(found.lights.lobe - configured().lights.lobe), 0.1);
}

TEST(LightCalibration, ThreadsDoNotChangeABit) {
  set_thread_count(1);
  const LightCalibration one = calibrate(SimulatedPictures());
  set_thread_count(0);
  const LightCalibration all = calibrate(SimulatedPictures());
  EXPECT_EQ(light_fragment(one, configured(), {}, "x"), light_fragment(all, configured(), {}, "x"));
  EXPECT_EQ(one.camera.led_intensity, all.camera.led_intensity);
}

TEST(LightCalibration, RefusesASingleDistance) {
  SimulatedPictures run;
  run.nearest = run.furthest = 0.02;
  run.tilt = 0.05;
  EXPECT_THAT(refusal(run), AllOf(HasSubstr("the camera's response cannot be told"),
                                  HasSubstr("Add pictures from other distances")));
}

TEST(LightCalibration, RefusesSaturatedPictures) {
  RigConfiguration truth = true_light();
  truth.camera.exposure_gain *= 100;
  EXPECT_THAT(refusal({}, truth), AllOf(HasSubstr("are saturated"), HasSubstr("exposure")));
}

TEST(LightCalibration, RefusesBlackPictures) {
  RigConfiguration truth = true_light();
  truth.camera.led_intensity *= 1e-4;
  EXPECT_THAT(refusal({}, truth), AllOf(HasSubstr("black"), HasSubstr("are the lamps on?")));
}

TEST(LightCalibration, RefusesAHandfulOfPictures) {
  SimulatedPictures run;
  run.pictures = 4;
  EXPECT_THAT(refusal(run), HasSubstr("at least 5 are needed"));
}

TEST(LightCalibration, RefusesWhatIsNoFlatCard) {
  SampleCounts counts;
  auto pictures = simulate_pictures(true_light(), {}, {}, counts);
  const CounterRandom random(4, 0);
  std::uint64_t n = 0;
  for (LightPicture& picture : pictures) {
    for (LightSample& sample : picture.samples) sample.level = 0.1 + 0.8 * random.uniform(n++);
  }
  EXPECT_THAT(refusal(pictures, counts), HasSubstr("do not fit a flat matte card"));
}

}  // namespace
}  // namespace gastronaut

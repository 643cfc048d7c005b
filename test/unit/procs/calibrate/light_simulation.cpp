#include "light_simulation.hpp"

#include <cmath>
#include <numbers>

#include "numerics/counter_random.hpp"

namespace gastronaut {
namespace {

constexpr int kAcross = 20;
constexpr int kDown = 15;
constexpr double kHalfWidth = 0.95;  // tangent at the picture's left and right border
constexpr double kHalfHeight = 0.72;
constexpr double kPixelsOfSample = 9;
constexpr double kQuantisation = 0.3 / 255;
constexpr double kDarkest = 20.0 / 255;
constexpr double kSaturated = 248.0 / 255;

// Light from the card along a ray of the camera, by intersecting it in the rig frame and adding up
// the lamps one by one.
double light_along(const RigConfiguration& truth, const SimulatedCard& card,
                   const SE3& rig_T_camera, const Eigen::Vector3d& ray) {
  const Eigen::Vector3d eye = rig_T_camera.translation;
  const Eigen::Vector3d direction = (rig_T_camera.rotation * ray).normalized();
  const double way = (card.height - card.normal.dot(eye)) / card.normal.dot(direction);
  if (!(way > 0)) return 0;
  const Eigen::Vector3d point = eye + way * direction;
  const Eigen::Vector3d optical_axis = rig_T_camera.rotation * Eigen::Vector3d::UnitZ();
  double sum = 0;
  for (int k = 0; k < truth.lights.count; ++k) {
    const double angle = 2 * std::numbers::pi * k / truth.lights.count + truth.lights.phase;
    const Eigen::Vector3d lamp =
        rig_T_camera * Eigen::Vector3d(truth.lights.radius * std::cos(angle),
                                       truth.lights.radius * std::sin(angle), 0);
    const Eigen::Vector3d from_lamp = point - lamp;
    const Eigen::Vector3d beam = from_lamp.normalized();
    const double lit = -card.normal.dot(beam);
    if (lit <= 0) continue;
    sum += truth.camera.led_intensity * std::pow(optical_axis.dot(beam), truth.lights.lobe) /
           from_lamp.squaredNorm() * card.albedo * lit;
  }
  const double off_axis = optical_axis.dot(direction);
  return truth.camera.exposure_gain * std::pow(off_axis, truth.camera.vignetting_cos_power) * sum;
}

}  // namespace

std::vector<LightPicture> simulate_pictures(const RigConfiguration& truth,
                                            const SimulatedCard& card, const SimulatedPictures& run,
                                            SampleCounts& counts) {
  const auto level_of = [&](double light) {
    return run.response ? run.response(light) : std::pow(light, 1 / truth.camera.gamma);
  };
  std::vector<LightPicture> pictures;
  for (int f = 0; f < run.pictures; ++f) {
    const CounterRandom random(run.seed, static_cast<std::uint64_t>(f));
    std::uint64_t drawn = 0;
    const auto normal = [&] { return random.normal(drawn++); };
    // To the far end and half way back, looking about.
    const double phase = 1.5 * f / run.pictures;
    const double away = phase < 1 ? phase : 2 - phase;
    const double distance = run.nearest * std::pow(run.furthest / run.nearest, away);
    const Eigen::Vector3d view =
        (-card.normal + run.tilt * (std::sin(9.0 * phase + 1) * Eigen::Vector3d::UnitX() +
                                    std::sin(14.0 * phase + 2) * Eigen::Vector3d::UnitY()))
            .normalized();
    const Eigen::Vector3d aim =
        card.height * card.normal + 0.004 * std::sin(5.0 * phase) * Eigen::Vector3d::UnitX();
    SE3 rig_T_camera;
    rig_T_camera.rotation = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), view) *
                            so3_exp(1.2 * std::sin(4.0 * phase) * Eigen::Vector3d::UnitZ());
    rig_T_camera.translation = aim - distance * view;

    LightPicture picture;
    picture.exposure = truth.camera.exposure_gain;
    picture.pose.emplace();
    Vector6d error;
    for (int i = 0; i < 6; ++i) error(i) = (i < 3 ? run.position_std : run.angle_std) * normal();
    picture.pose->rig_T_camera = run.poses_err ? rig_T_camera * SE3::exp(error) : rig_T_camera;
    picture.pose->information.setZero();
    picture.pose->information.diagonal().head<3>().setConstant(std::pow(run.position_std, -2));
    picture.pose->information.diagonal().tail<3>().setConstant(std::pow(run.angle_std, -2));
    for (int row = 0; row < kDown; ++row) {
      for (int col = 0; col < kAcross; ++col) {
        LightSample sample;
        sample.ray = {kHalfWidth * (2 * (col + 0.5) / kAcross - 1),
                      kHalfHeight * (2 * (row + 0.5) / kDown - 1), 1};
        const double light = light_along(truth, card, rig_T_camera, sample.ray);
        sample.level = level_of(light);
        if (run.noisy && light > 0) {
          const CameraConfiguration& camera = truth.camera;
          const double variance =
              camera.read_noise * camera.read_noise + camera.shot_noise * camera.shot_noise * light;
          const double step = 1e-4 * light;
          const double slope = (level_of(light + step) - level_of(light - step)) / (2 * step);
          sample.level += normal() * std::sqrt(slope * slope * variance / kPixelsOfSample +
                                               kQuantisation * kQuantisation);
          // The mean of noisy levels is not the level of the mean light.
          sample.level += variance / 2 *
                          (level_of(light + step) + level_of(light - step) - 2 * level_of(light)) /
                          (step * step);
        }
        if (sample.level > kSaturated) {
          ++counts.saturated;
        } else if (sample.level < kDarkest) {
          ++counts.dark;
        } else {
          ++counts.used;
          picture.samples.push_back(sample);
        }
      }
    }
    pictures.push_back(std::move(picture));
  }
  return pictures;
}

}  // namespace gastronaut

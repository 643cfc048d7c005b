#include "calibrate/hand_eye_report.hpp"

#include <spdlog/fmt/fmt.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <numbers>

#include "calibrate/calibration_report.hpp"
#include "configuration/fields.hpp"

namespace gastronaut {
namespace {

constexpr double kMilli = 1e3;
constexpr double kPercent = 100;
constexpr double kDegrees = 180 / std::numbers::pi;

// One sigma in the direction that is known least.
template <int Size>
double largest_std(const HandEyeMatrix& covariance, int at) {
  using Block = Eigen::Matrix<double, Size, Size>;
  return std::sqrt(Eigen::SelfAdjointEigenSolver<Block>(Block(covariance.block<Size, Size>(at, at)),
                                                        Eigen::EigenvaluesOnly)
                       .eigenvalues()(Size - 1));
}

// One sigma of the axis' components in the camera frame.
Eigen::Vector3d axis_stds(const Eigen::Vector3d& axis, const Eigen::Matrix2d& covariance) {
  const Eigen::Matrix<double, 3, 2> turns = -skew(axis) * perpendicular_basis(axis);
  return (turns * covariance * turns.transpose()).diagonal().cwiseSqrt();
}

std::string triple(const Eigen::Vector3d& v, const char* format) {
  return fmt::format(fmt::runtime(fmt::format("{0}, {0}, {0}", format)), v.x(), v.y(), v.z());
}

}  // namespace

std::string hand_eye_table(const HandEyeCalibration& calibration, const SE3& configured) {
  const HandEye& hand_eye = calibration.estimate;
  const HandEyeVector sigma = calibration.covariance.diagonal().cwiseSqrt();
  const Eigen::Vector3d old_axis = configured.rotation * Eigen::Vector3d::UnitZ();
  const double turned =
      std::atan2(old_axis.cross(hand_eye.axis).norm(), old_axis.dot(hand_eye.axis));
  std::string text;
  text += fmt::format("magnet's centre in the camera   {} mm   +-{} mm\n",
                      triple(hand_eye.centre * kMilli, "{:.3f}"),
                      triple(sigma.segment<3>(kCentreAt) * kMilli, "{:.3f}"));
  text += fmt::format(
      "magnet's axis in the camera     {}   +-{} degrees\n", triple(hand_eye.axis, "{:.5f}"),
      triple(
          axis_stds(hand_eye.axis, calibration.covariance.block<2, 2>(kAxisAt, kAxisAt)) * kDegrees,
          "{:.3f}"));
  text +=
      fmt::format("change from the configured      {:.2f} mm, {:.2f} degrees\n",
                  (hand_eye.centre - configured.translation).norm() * kMilli, turned * kDegrees);
  text += fmt::format("scale of the visual map         {:.4f}   +-{:.4f}\n", hand_eye.scale,
                      hand_eye.scale * sigma(kLogScaleAt));
  text += fmt::format("visual map in the rig           {} mm, turned by {} degrees\n",
                      triple(hand_eye.rig_T_map.translation * kMilli, "{:.2f}"),
                      triple(so3_log(hand_eye.rig_T_map.rotation) * kDegrees, "{:.2f}"));
  text += fmt::format("                                +-{} mm, +-{} degrees\n",
                      triple(sigma.segment<3>(kMapTranslationAt) * kMilli, "{:.2f}"),
                      triple(sigma.segment<3>(kMapRotationAt) * kDegrees, "{:.2f}"));
  text += fmt::format("magnetic time offset            {:.2f} ms   +-{:.2f} ms\n",
                      hand_eye.time_offset * kMilli, sigma(kTimeOffsetAt) * kMilli);
  text += fmt::format("residual, rms                   {:.3f} mm, {:.3f} degrees\n",
                      calibration.position_rms * kMilli, calibration.axis_rms * kDegrees);
  const auto hidden = [](double position, double axis) {
    return fmt::format("{:.3f} mm, {:.3f} degrees", position * kMilli, axis * kDegrees);
  };
  const HandEyeNoise& noise = calibration.noise;
  text += fmt::format("errors beyond those reported    {} a pose; {} of the place; {} of drift\n",
                      hidden(noise.own_position_std, noise.own_axis_std),
                      hidden(noise.magnetic_position_std, noise.magnetic_axis_std),
                      hidden(noise.visual_position_std, noise.visual_axis_std));
  text += fmt::format("chi2 per degree of freedom      {:.2f}\n", calibration.chi2_per_dof);
  text += fmt::format("poses                           {} of {} fixes; {} do not fit\n",
                      calibration.poses, calibration.fixes, calibration.misfits);
  text += fmt::format(
      "leaving out one of {:<4}         centre +-{} mm, at most {:.3f} mm off; axis +-{:.3f} "
      "degrees, at most {:.3f} off\n",
      calibration.parts, triple(calibration.jackknife_std.head<3>() * kMilli, "{:.3f}"),
      calibration.centre_shift * kMilli, calibration.jackknife_std.tail<2>().maxCoeff() * kDegrees,
      calibration.axis_shift * kDegrees);
  text += fmt::format("weakest                         {}\n", calibration.advice.weakest);
  text += calibration.advice.motion.empty()
              ? fmt::format(
                    "more motion                     not needed for {:g} mm and {:g} "
                    "degree\n",
                    kCentreTarget * kMilli, kAxisTarget * kDegrees)
              : fmt::format("for {:g} mm and {:g} degree       {}\n", kCentreTarget * kMilli,
                            kAxisTarget * kDegrees, calibration.advice.motion);
  return text;
}

std::string hand_eye_fragment(const HandEyeCalibration& calibration, const SE3& configured,
                              const std::string& log) {
  const HandEye& hand_eye = calibration.estimate;
  const std::string head =
      fmt::format(
          "Made by `calibrate hand-eye` from {}. Give it after the rig's own file: --config "
          "RIG.yaml --config THIS.yaml\nThe roll about the magnet's axis cannot be measured and "
          "does not matter: rotation is the shortest that takes z to the axis.\n",
          log) +
      hand_eye_table(calibration, configured);
  const Eigen::Quaterniond rotation =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), hand_eye.axis);
  YAML::Emitter out;
  FieldWriter writer(out);
  out << YAML::BeginMap << YAML::Key << "camera_T_magnet" << YAML::Value << YAML::BeginMap;
  writer("translation", hand_eye.centre);
  writer("rotation", std::vector<double>{rotation.w(), rotation.x(), rotation.y(), rotation.z()});
  out << YAML::EndMap << YAML::Key << "sensor_fusion" << YAML::Value << YAML::BeginMap;
  writer("hand_eye_position_std", largest_std<3>(calibration.covariance, kCentreAt));
  writer("hand_eye_axis_std", largest_std<2>(calibration.covariance, kAxisAt));
  writer("magnetic_time_offset", hand_eye.time_offset);
  writer("magnetic_time_offset_std",
         std::sqrt(calibration.covariance(kTimeOffsetAt, kTimeOffsetAt)));
  out << YAML::EndMap << YAML::EndMap;
  return commented(head) + out.c_str() + "\n";
}

}  // namespace gastronaut

#include "synthetic_capture.hpp"

#include <iomanip>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <sstream>

#include "magnetics/dipole.hpp"

namespace gastronaut {
namespace {

constexpr double kPitch = 0.022;
constexpr double kArrayHeight = 0.085;
constexpr int kDigits = 10;

// The coils as dipoles of one A m^2 per ampere below the table.
Eigen::MatrixXd coil_matrix(const std::vector<Eigen::Vector3d>& sensors) {
  Eigen::MatrixXd matrix(SyntheticCapture::kChannels, SyntheticCapture::kCoils);
  for (std::size_t s = 0; s < sensors.size(); ++s) {
    for (int c = 0; c < matrix.cols(); ++c) {
      matrix.block<3, 1>(static_cast<int>(3 * s), c) =
          dipole_field(sensors[s] - Eigen::Vector3d(0.06 * c, 0, -0.13), Eigen::Vector3d::UnitZ());
    }
  }
  return matrix;
}

std::string row(double time, const Eigen::VectorXd& values, char separator) {
  std::ostringstream text;
  text << std::setprecision(kDigits) << time;
  for (const double value : values) text << separator << value;
  return text.str() + "\n";
}

}  // namespace

SyntheticCapture::SyntheticCapture(const ScratchFolder& folder) {
  std::vector<Eigen::Vector3d> sensors;
  for (const double x : {-0.5, 0.5}) {
    for (const double y : {-0.5, 0.5}) sensors.push_back({x * kPitch, y * kPitch, kArrayHeight});
  }
  const Eigen::MatrixXd coils = coil_matrix(sensors);
  std::ostringstream calibration;
  calibration << std::setprecision(kDigits)
              << "camera: {width: 48, height: 32, fx: 25, fy: 25, cx: 23.5, cy: 15.5, "
                 "distortion: [-0.12, 0.018, 0, 0], gamma: 2.2, rate: 20, exposure_gain: 4, "
                 "led_intensity: 2.2e-4, vignetting_cos_power: 1.0}\n"
                 "depth: {metres_per_count: 1e-05}\n"
                 "leds: {radius: 0.0032, phase: 0.3, count: 4, lobe: 1.2}\n"
                 "magnet: {moment: 0.408, outer_radius: 0.0055, inner_radius: 0.003, "
                 "length: 0.006}\n"
                 "camera_T_magnet: {t: [0, 0, -0.009], q_xyzw: [1, 0, 0, 0]}\n"
                 "hall: {rows: 2, cols: 2, pitch: 0.022, z: 0.085, noise: 1.5e-06, rate: 100}\n"
                 "coils: {rows: 1, cols: 2, pitch: 0.06, z: -0.13}\n"
                 "coil_matrix_tesla_per_ampere: # channel by channel\n";
  for (int i = 0; i < coils.rows(); ++i) {
    calibration << "  - [" << coils(i, 0) << ", " << coils(i, 1) << "]\n";
  }
  folder.write("calib.yaml", calibration.str());

  std::string hall_text;
  std::string currents_text;
  for (int i = 0; i < kReadings; ++i) {
    const double time = i / kHallRate;
    currents.push_back(Eigen::Vector2d(1 + time, -2));
    Eigen::VectorXd field = coils * currents.back();
    for (std::size_t s = 0; s < sensors.size(); ++s) {
      field.segment<3>(static_cast<int>(3 * s)) +=
          dipole_field(sensors[s] - Eigen::Vector3d(0.01 * time, 0, 0), {0, 0, 0.408});
    }
    hall.push_back(field);
    hall_text += row(time, field, ',');
    currents_text += row(time, currents.back(), ',');
  }
  folder.write("hall.csv", hall_text);
  folder.write("coils.csv", currents_text);

  std::string poses = "# world_T_camera: timestamp tx ty tz qx qy qz qw\n";
  for (int i = 0; i < kFrames; ++i) {
    camera.push_back({0.001 * i, 0.002, 0.003});
    Eigen::VectorXd pose(7);
    pose << camera.back(), 1, 0, 0, 0;
    poses += row(i / kFrameRate, pose, ' ');
    const cv::Mat picture(kHeight, kWidth, CV_8UC3, cv::Scalar(10 * i, 60, 120));
    auto& jpeg = pictures.emplace_back();
    cv::imencode(".jpg", picture, jpeg);
    std::ostringstream number;
    number << std::setw(6) << std::setfill('0') << i;
    folder.write("rgb/" + number.str() + ".jpg", {jpeg.begin(), jpeg.end()});
    const cv::Mat depth(kHeight, kWidth, CV_16UC1, cv::Scalar(kWall / kMetresPerCount));
    std::vector<std::uint8_t> png;
    cv::imencode(".png", depth, png);
    folder.write("depth/" + number.str() + ".png", {png.begin(), png.end()});
  }
  folder.write("groundtruth.txt", poses);
}

}  // namespace gastronaut

#include "calibrate/missing_motion.hpp"

#include <spdlog/fmt/fmt.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace gastronaut {
namespace {

constexpr double kDegree = std::numbers::pi / 180;
constexpr double kNarrowCone = 40 * kDegree;  // half angle; less turning than this is little
constexpr double kShortPath = 0.25;           // of the array's width
constexpr double kMostOfThem = 0.95;          // of the readings: single fixes may be off
constexpr double kNearRigAxis = 25 * kDegree;
constexpr double kOffCentre = 0.2;  // of the array's width, mean position of a group on one side
constexpr std::array<const char*, 3> kNames = {"x", "y", "z"};

double fraction_of(std::vector<double> values, double fraction) {
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(fraction * static_cast<double>(values.size() - 1))];
}

Eigen::Vector2d width(const std::vector<Eigen::Vector3d>& positions) {
  Eigen::Vector3d low = positions.front();
  Eigen::Vector3d high = low;
  for (const Eigen::Vector3d& position : positions) {
    low = low.cwiseMin(position);
    high = high.cwiseMax(position);
  }
  return (high - low).head<2>();
}

}  // namespace

std::string name_sensors(const std::vector<int>& sensors,
                         const std::vector<Eigen::Vector3d>& positions) {
  std::string text = sensors.size() == 1 ? "sensor " : "sensors ";
  for (std::size_t i = 0; i < sensors.size();) {
    std::size_t end = i + 1;
    while (end < sensors.size() && sensors[end] == sensors[end - 1] + 1) ++end;
    text += (i == 0 ? "" : ", ") + std::to_string(sensors[i]);
    if (end - i > 1) text += (end - i > 2 ? "-" : ", ") + std::to_string(sensors[end - 1]);
    i = end;
  }
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& position : positions) centre += position;
  centre /= static_cast<double>(positions.size());
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const int sensor : sensors) mean += positions[static_cast<std::size_t>(sensor)];
  mean = mean / static_cast<double>(sensors.size()) - centre;
  std::string side;
  for (int axis = 0; axis < 2; ++axis) {
    if (std::abs(mean(axis)) < kOffCentre * width(positions)(axis) || mean(axis) == 0) continue;
    side += std::string(side.empty() ? "" : " ") + (mean(axis) > 0 ? "+" : "-") +
            kNames[static_cast<std::size_t>(axis)];
  }
  return side.empty() ? text : text + " (" + side + " side)";
}

std::vector<std::string> describe_missing_motion(const std::vector<MagnetPose>& poses,
                                                 const std::vector<Eigen::Vector3d>& positions) {
  std::vector<std::string> sentences;
  if (poses.empty()) return sentences;
  Eigen::Matrix3d scatter = Eigen::Matrix3d::Zero();
  for (const MagnetPose& pose : poses) scatter += pose.axis * pose.axis.transpose();
  const Eigen::Vector3d main =
      Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(scatter).eigenvectors().col(2);
  std::vector<double> angles;
  for (const MagnetPose& pose : poses) {
    angles.push_back(std::acos(std::min(1.0, std::abs(main.dot(pose.axis)))));
  }
  const double cone = fraction_of(angles, kMostOfThem);
  if (cone < kNarrowCone) {
    Eigen::Index nearest = 0;
    const double along = main.cwiseAbs().maxCoeff(&nearest);
    const bool named = std::acos(std::min(1.0, along)) < kNearRigAxis;
    const auto name = [&](Eigen::Index offset) {
      return kNames[static_cast<std::size_t>((nearest + offset) % 3)];
    };
    const std::string direction =
        named ? name(0) : fmt::format("({:.2f}, {:.2f}, {:.2f})", main(0), main(1), main(2));
    std::array<const char*, 2> others = {name(1), name(2)};
    std::sort(others.begin(), others.end(), [](auto a, auto b) { return *a < *b; });
    sentences.push_back(
        fmt::format("the magnet's axis stayed within {:.0f} degrees of {}: turn it {}",
                    std::ceil(cone / kDegree), direction,
                    named ? fmt::format("about {} and {}", others[0], others[1])
                          : std::string("about the two directions across that")));
  }
  const Eigen::Vector2d array = width(positions);
  for (int axis = 0; axis < 2; ++axis) {
    std::vector<double> places;
    for (const MagnetPose& pose : poses) places.push_back(pose.position(axis));
    const double path = fraction_of(places, kMostOfThem) - fraction_of(places, 1 - kMostOfThem);
    if (path < kShortPath * array(axis)) {
      sentences.push_back(fmt::format(
          "the magnet moved only {:.0f} mm along {} under an array {:.0f} mm wide: move it from "
          "one side of the array to the other",
          path * 1e3, kNames[static_cast<std::size_t>(axis)], array(axis) * 1e3));
    }
  }
  return sentences;
}

}  // namespace gastronaut

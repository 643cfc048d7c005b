// usage: hand_eye_benchmark [SEEDS]
// Error of the hand-eye calibration from magnetic fixes of five degrees of freedom, beside OpenCV's
// calibrateHandEye on the same poses: given the true roll about the magnet's axis (which no Hall
// array measures), given an arbitrary one, and given the one of the shortest rotation from z.
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <numbers>
#include <opencv2/calib3d.hpp>
#include <string>
#include <vector>

#include "calibrate/hand_eye_calibration.hpp"
#include "numerics/counter_random.hpp"
#include "unit/procs/calibrate/hand_eye_simulation.hpp"

namespace gastronaut {
namespace {

enum class Roll { kTrue, kArbitrary, kShortest };

struct Mean {
  double centre = 0;  // metres
  double axis = 0;    // radians
  double milliseconds = 0;
  int failures = 0;  // no answer, or one that is not finite
  int count = 0;

  void add(const Vector5d& error, double time) {
    milliseconds += time;
    ++count;
    if (!error.allFinite()) {
      ++failures;
      return;
    }
    centre += error.head<3>().norm();
    axis += std::asin(std::min(1.0, error.tail<2>().norm()));
  }
  void print(const std::string& what) const {
    const double good = count - failures;
    std::printf("%-44s %9.3f mm %8.3f degrees %8.2f ms%s\n", what.c_str(), centre / good * 1e3,
                axis / good / kOneDegree, milliseconds / count,
                failures > 0 ? (" (" + std::to_string(failures) + " failed)").c_str() : "");
  }
};

double since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start)
      .count();
}

cv::Mat matrix(const Eigen::Quaterniond& rotation) {
  const Eigen::Matrix3d r = rotation.toRotationMatrix();
  cv::Mat m(3, 3, CV_64F);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) m.at<double>(i, j) = r(i, j);
  }
  return m;
}

cv::Mat column(const Eigen::Vector3d& v) { return (cv::Mat_<double>(3, 1) << v(0), v(1), v(2)); }

// The magnet as OpenCV's gripper, the rig as its base, the map as its target.
Vector5d opencv_error(const SimulatedHandEye& run, const std::vector<SE3>& poses,
                      const HandEye& truth, cv::HandEyeCalibrationMethod method, Roll roll,
                      std::uint64_t seed) {
  const CounterRandom random(seed, 9);
  const auto magnet_in_camera =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), truth.axis);
  std::vector<cv::Mat> gripper_r;
  std::vector<cv::Mat> gripper_t;
  std::vector<cv::Mat> target_r;
  std::vector<cv::Mat> target_t;
  for (std::size_t i = 0; i < run.fixes.size(); ++i) {
    const MagneticFix& fix = run.fixes[i];
    const Eigen::Quaterniond real = truth.rig_T_map.rotation * poses[i].rotation * magnet_in_camera;
    const Eigen::Vector3d real_axis = real * Eigen::Vector3d::UnitZ();
    Eigen::Quaterniond rotation =
        roll == Roll::kShortest
            ? Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), fix.axis)
            : Eigen::Quaterniond::FromTwoVectors(real_axis, fix.axis) * real;
    if (roll == Roll::kArbitrary) {
      rotation = rotation * Eigen::AngleAxisd(2 * std::numbers::pi * random.uniform(i),
                                              Eigen::Vector3d::UnitZ());
    }
    gripper_r.push_back(matrix(rotation));
    gripper_t.push_back(column(fix.position));
    const SE3 camera_T_map = run.frames[2 * i].map_T_camera.inverse();
    target_r.push_back(matrix(camera_T_map.rotation));
    target_t.push_back(column(camera_T_map.translation));
  }
  cv::Mat r;
  cv::Mat t;
  try {
    cv::calibrateHandEye(gripper_r, gripper_t, target_r, target_t, r, t, method);
  } catch (const cv::Exception&) {  // "Rotation normalization issue" and the like
    return Vector5d::Constant(std::numeric_limits<double>::quiet_NaN());
  }
  SE3 magnet_T_camera;
  Eigen::Matrix3d rotation;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) rotation(i, j) = r.at<double>(i, j);
    magnet_T_camera.translation(i) = t.at<double>(i);
  }
  magnet_T_camera.rotation = Eigen::Quaterniond(rotation);
  const SE3 camera_T_magnet = magnet_T_camera.inverse();
  HandEye estimate;
  estimate.centre = camera_T_magnet.translation;
  estimate.axis = (camera_T_magnet.rotation * Eigen::Vector3d::UnitZ()).normalized();
  return hand_eye_error(estimate, truth);
}

void compare(int poses, int seeds) {
  HandEye truth = true_hand_eye();
  truth.scale = 1;  // OpenCV has none
  struct Method {
    const char* name;
    cv::HandEyeCalibrationMethod method;
  };
  const std::vector<Method> methods = {{"Tsai", cv::CALIB_HAND_EYE_TSAI},
                                       {"Park", cv::CALIB_HAND_EYE_PARK},
                                       {"Horaud", cv::CALIB_HAND_EYE_HORAUD},
                                       {"Andreff", cv::CALIB_HAND_EYE_ANDREFF},
                                       {"Daniilidis", cv::CALIB_HAND_EYE_DANIILIDIS}};
  struct Given {
    const char* name;
    Roll roll;
  };
  const std::vector<Given> rolls = {{"true roll", Roll::kTrue},
                                    {"arbitrary roll", Roll::kArbitrary},
                                    {"shortest rotation", Roll::kShortest}};
  Mean ours;
  std::vector<std::vector<Mean>> theirs(rolls.size(), std::vector<Mean>(methods.size()));
  double nees = 0;
  for (int seed = 0; seed < seeds; ++seed) {
    const auto number = static_cast<std::uint64_t>(seed);
    const std::vector<SE3> places = random_poses(poses, number);
    const SimulatedHandEye run = stop_and_go(truth, places, {}, number);
    const auto start = std::chrono::steady_clock::now();
    const HandEyeCalibration calibration = calibrate_hand_eye(
        VisualTrack(run.frames, 0.2), run.fixes, wrong_hand_eye(), [](double) {});
    const Vector5d error = hand_eye_error(calibration.estimate, truth);
    ours.add(error, since(start));
    nees += error.dot(calibration.covariance.topLeftCorner<5, 5>().inverse() * error) / seeds;
    for (std::size_t i = 0; i < rolls.size(); ++i) {
      for (std::size_t j = 0; j < methods.size(); ++j) {
        const auto begin = std::chrono::steady_clock::now();
        const Vector5d off =
            opencv_error(run, places, truth, methods[j].method, rolls[i].roll, number);
        theirs[i][j].add(off, since(begin));
      }
    }
  }
  std::printf("%d poses, mean of %d seeds\n", poses, seeds);
  ours.print("  ours, no roll");
  std::printf("  %-42s %9.2f of 5\n", "ours, NEES of centre and axis", nees);
  for (std::size_t i = 0; i < rolls.size(); ++i) {
    for (std::size_t j = 0; j < methods.size(); ++j) {
      theirs[i][j].print(std::string("  OpenCV ") + methods[j].name + ", " + rolls[i].name);
    }
  }
}

}  // namespace
}  // namespace gastronaut

int main(int argc, char** argv) {
  const int seeds = argc > 1 ? std::atoi(argv[1]) : 50;
  if (argc > 2 || seeds < 1) {
    std::fprintf(stderr, "usage: hand_eye_benchmark [SEEDS]\n");
    return 2;
  }
  gastronaut::compare(20, seeds);
  gastronaut::compare(80, seeds);
  return 0;
}

#include "trajectory/trajectory_file.hpp"

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>

#include "process/whole_file.hpp"

namespace gastronaut {
namespace {

constexpr std::size_t kTumColumns = 8;
constexpr std::size_t kKittiColumns = 12;
// A rotation further from orthonormal than this is no rotation, rounding of file formats included.
constexpr double kMaxRotationDefect = 1e-2;

std::vector<double> split_numbers(const std::string& line) {
  std::vector<double> numbers;
  std::istringstream words(line);
  std::string word;
  while (words >> word) {
    std::size_t used = 0;
    double number = 0;
    try {
      number = std::stod(word, &used);
    } catch (const std::exception&) {
      throw std::runtime_error("\"" + word + "\" is not a number");
    }
    if (used != word.size() || !std::isfinite(number)) {
      throw std::runtime_error("\"" + word + "\" is not a finite number");
    }
    numbers.push_back(number);
  }
  return numbers;
}

Pose tum_pose(const std::vector<double>& row) {
  Eigen::Quaterniond rotation(row[7], row[4], row[5], row[6]);
  if (std::abs(rotation.norm() - 1) > kMaxRotationDefect) {
    throw std::runtime_error("columns 5 to 8 are not a unit quaternion x y z w");
  }
  rotation.normalize();
  return {rotation.toRotationMatrix(), {row[1], row[2], row[3]}};
}

Pose kitti_pose(const std::vector<double>& row) {
  const Eigen::Matrix<double, 3, 4> matrix =
      Eigen::Map<const Eigen::Matrix<double, 3, 4, Eigen::RowMajor>>(row.data());
  const Eigen::Matrix3d rotation = matrix.leftCols<3>();
  const double defect = (rotation.transpose() * rotation - Eigen::Matrix3d::Identity()).norm();
  if (defect > kMaxRotationDefect || rotation.determinant() < 0) {
    throw std::runtime_error("the 3x3 part is not a rotation matrix");
  }
  return {rotation, matrix.col(3)};
}

}  // namespace

StampedPoses read_trajectory(const std::string& path, TrajectoryFormat format) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error("cannot read " + path);
  const std::size_t columns = format == TrajectoryFormat::kTum ? kTumColumns : kKittiColumns;
  std::map<std::int64_t, Pose> poses;
  std::string line;
  for (int number = 1; std::getline(file, line); ++number) {
    const std::size_t start = line.find_first_not_of(" \t\r");
    if (start == std::string::npos || line[start] == '#') continue;
    for (char& character : line) {
      if (character == ',') character = ' ';
    }
    try {
      const std::vector<double> row = split_numbers(line);
      if (row.size() != columns) {
        throw std::runtime_error(std::to_string(columns) + " numbers expected, found " +
                                 std::to_string(row.size()));
      }
      const bool tum = format == TrajectoryFormat::kTum;
      const auto utime = tum ? static_cast<std::int64_t>(std::llround(row[0] * 1e6))
                             : static_cast<std::int64_t>(poses.size());
      poses[utime] = tum ? tum_pose(row) : kitti_pose(row);
    } catch (const std::runtime_error& error) {
      throw std::runtime_error(path + ":" + std::to_string(number) + ": " + error.what());
    }
  }
  if (poses.empty()) throw std::runtime_error(path + " holds no pose");
  StampedPoses trajectory;
  for (const auto& [utime, pose] : poses) {
    trajectory.utimes.push_back(utime);
    trajectory.poses.push_back(pose);
  }
  return trajectory;
}

void write_tum(const std::string& path, const StampedPoses& trajectory) {
  write_whole(path, [&](std::ofstream& file) {
    file << "# timestamp tx ty tz qx qy qz qw\n";
    for (std::size_t i = 0; i < trajectory.size(); ++i) {
      const Eigen::Vector3d& t = trajectory.poses[i].translation;
      const Eigen::Quaterniond q(trajectory.poses[i].rotation);
      std::array<char, 256> line{};
      std::snprintf(line.data(), line.size(), "%lld.%06lld %.9f %.9f %.9f %.9f %.9f %.9f %.9f\n",
                    static_cast<long long>(trajectory.utimes[i] / 1000000),
                    static_cast<long long>(trajectory.utimes[i] % 1000000), t.x(), t.y(), t.z(),
                    q.x(), q.y(), q.z(), q.w());
      file << line.data();
    }
  });
}

}  // namespace gastronaut

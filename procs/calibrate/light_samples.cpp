#include "calibrate/light_samples.hpp"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numbers>

namespace gastronaut {
namespace {

constexpr int kPlacesAcross = 32;
constexpr int kPlacesDown = 24;
constexpr int kSaturated = 250;    // clipping has begun for pixels with noise above the mean
constexpr double kDarkest = 20;    // mean level: below it the noise is a good part of the light
constexpr int kWindow = 9;         // pixels of a sample
constexpr int kDepthWindow = 130;  // the picture's width over the half width of the plane's fit
constexpr double kUneven = 0.01;   // of the inverse depth, rms about the fitted plane
constexpr double kGrazing = 0.5;   // cosine between normal and view: beyond lie shadows of folds
// Highlights of mucus lie where the normal halves the angle between light and view, that is, where
// the wall is seen face on; the exponents of wet tissue reach that far.
constexpr double kHighlightReach = 22 * std::numbers::pi / 180;
constexpr double kPlace = 0.003;  // metres, side of a cube: less than albedo varies over
constexpr std::int64_t kNoCube = std::numeric_limits<std::int64_t>::max();
constexpr double kTurn = 2 * std::numbers::pi;

// The plane m . X = 1 about column u, row v: inverse depth is affine in the picture.
std::optional<Eigen::Vector3d> fit_plane(const DepthMap& map, double u, double v) {
  const int half = std::clamp(map.depth.width / kDepthWindow, 1, 4);
  const auto col = static_cast<int>(std::lround(u));
  const auto row = static_cast<int>(std::lround(v));
  if (col < half || row < half || col >= map.depth.width - half || row >= map.depth.height - half) {
    return std::nullopt;
  }
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  double squares = 0;
  double count = 0;
  for (int r = row - half; r <= row + half; ++r) {
    for (int c = col - half; c <= col + half; ++c) {
      const double depth = static_cast<double>(map.depth.at(c, r));
      if (!(depth > 0)) return std::nullopt;
      const Eigen::Vector3d place((c - u) / map.fx, (r - v) / map.fy, 1);
      normal += place * place.transpose();
      right += place / depth;
      squares += 1 / (depth * depth);
      ++count;
    }
  }
  const Eigen::Vector3d solution = normal.ldlt().solve(right);
  const double residual = std::max(0.0, squares - solution.dot(right)) / count;
  if (std::sqrt(residual) > kUneven * solution.z()) return Eigen::Vector3d::Zero();
  // From the sample's own ray to the optical axis.
  const double x = (u - map.cx) / map.fx;
  const double y = (v - map.cy) / map.fy;
  return Eigen::Vector3d(solution.x(), solution.y(),
                         solution.z() - solution.x() * x - solution.y() * y);
}

}  // namespace

std::vector<LightSample> take_samples(const std::array<Plane<std::uint8_t>, 3>& picture,
                                      const CameraModel& camera,
                                      const std::optional<DepthMap>& depth, SampleCounts& counts) {
  std::vector<LightSample> samples;
  const int width = picture[0].width;
  const int height = picture[0].height;
  if (width < 3 || height < 3) return samples;
  for (int i = 0; i < kPlacesDown; ++i) {
    for (int j = 0; j < kPlacesAcross; ++j) {
      const int row = 1 + (2 * i + 1) * (height - 2) / (2 * kPlacesDown);
      const int col = 1 + (2 * j + 1) * (width - 2) / (2 * kPlacesAcross);
      int sum = 0;
      int brightest = 0;
      for (int r = row - 1; r <= row + 1; ++r) {
        for (int c = col - 1; c <= col + 1; ++c) {
          sum += picture[0].at(c, r);
          for (const auto& channel : picture)
            brightest = std::max<int>(brightest, channel.at(c, r));
        }
      }
      LightSample sample;
      const double mean = static_cast<double>(sum) / kWindow;
      sample.level = mean / 255;
      if (brightest >= kSaturated) {
        ++counts.saturated;
        continue;
      }
      if (mean < kDarkest) {
        ++counts.dark;
        continue;
      }
      const auto ray = camera.unproject({static_cast<double>(col), static_cast<double>(row)});
      if (!ray || !(ray->z() > 0)) {
        ++counts.without_ray;
        continue;
      }
      sample.ray = *ray / ray->z();
      if (depth) {
        const auto plane = fit_plane(*depth, depth->cx + depth->fx * sample.ray.x(),
                                     depth->cy + depth->fy * sample.ray.y());
        if (!plane) {
          ++counts.without_depth;
          continue;
        }
        const double facing =
            plane->isZero() ? 0 : plane->dot(sample.ray) / (plane->norm() * sample.ray.norm());
        if (facing < kGrazing || facing > std::cos(kHighlightReach)) {
          ++counts.unsuitable;
          continue;
        }
        sample.plane = *plane;
      }
      ++counts.used;
      samples.push_back(sample);
    }
  }
  return samples;
}

void number_places(const std::vector<std::optional<SE3>>& rig_T_cameras,
                   std::vector<LightPicture>& pictures) {
  std::map<std::array<std::int64_t, 3>, int> numbers;
  for (std::size_t f = 0; f < pictures.size(); ++f) {
    for (LightSample& sample : pictures[f].samples) {
      std::array<std::int64_t, 3> cube = {kNoCube, static_cast<std::int64_t>(f), 0};
      if (rig_T_cameras[f]) {
        const Eigen::Vector3d point =
            *rig_T_cameras[f] * Eigen::Vector3d(sample.ray / sample.plane.dot(sample.ray));
        for (Eigen::Index i = 0; i < 3; ++i) {
          cube[static_cast<std::size_t>(i)] = std::llround(point(i) / kPlace);
        }
      }
      sample.place = numbers.try_emplace(cube, static_cast<int>(numbers.size())).first->second;
    }
  }
}

CameraPosePrior pose_from_magnet(const Eigen::Vector3d& position, const Eigen::Vector3d& axis,
                                 const Matrix5d& covariance, const SE3& camera_T_magnet,
                                 double position_std, double angle_std) {
  CameraPosePrior prior;
  const SE3 rig_T_magnet = {Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), axis),
                            position};
  prior.rig_T_camera = rig_T_magnet * camera_T_magnet.inverse();
  prior.roll_axis = camera_T_magnet.rotation * Eigen::Vector3d::UnitZ();
  prior.roll_centre = camera_T_magnet.translation;
  // The camera's twist, camera frame, by the magnet's displacement and turns, rig frame.
  const Eigen::Matrix3d camera_R_rig = prior.rig_T_camera.rotation.conjugate().toRotationMatrix();
  Eigen::Matrix3d turns;
  turns << perpendicular_basis(axis), axis;
  Matrix6d twist = Matrix6d::Zero();
  twist.topLeftCorner<3, 3>() = camera_R_rig;
  twist.topRightCorner<3, 3>() =
      -camera_R_rig * skew(prior.rig_T_camera.translation - position) * turns;
  twist.bottomRightCorner<3, 3>() = camera_R_rig * turns;
  Matrix6d of_magnet = Matrix6d::Zero();
  of_magnet.topLeftCorner<5, 5>() = covariance;
  of_magnet.diagonal().head<3>().array() += position_std * position_std;
  of_magnet.diagonal().segment<2>(3).array() += angle_std * angle_std;
  of_magnet(5, 5) = kTurn * kTurn;  // any angle, for what a Gaussian can say of it
  prior.information = (twist * of_magnet * twist.transpose()).inverse();
  return prior;
}

}  // namespace gastronaut

// Pinhole camera with OpenCV's radial-tangential or fisheye (equidistant) lens distortion.
// Camera frame: x right, y down, z forward. Pixels: the centre of the first one is (0, 0).
#pragma once

#include <Eigen/Core>
#include <array>
#include <optional>
#include <vector>

namespace gastronaut {

enum class LensModel {
  kRadialTangential,  // distortion k1 k2 p1 p2 [k3 [k4 k5 k6]] as in cv::projectPoints
  kFisheye,           // distortion k1 k2 k3 k4 as in cv::fisheye::projectPoints
};

struct CameraIntrinsics {
  int width = 0;  // pixels
  int height = 0;
  double fx = 0;  // pixels
  double fy = 0;
  double cx = 0;
  double cy = 0;
  LensModel model = LensModel::kRadialTangential;
  std::vector<double> distortion;  // missing trailing coefficients are zero
};

class CameraModel {
 public:
  // Throws std::invalid_argument for a size or focal length that is not positive, a principal
  // point outside the picture, or a wrong number of coefficients.
  explicit CameraModel(const CameraIntrinsics& intrinsics);

  const CameraIntrinsics& intrinsics() const { return intrinsics_; }

  // Pixel of a point in the camera frame (metres); nothing for points at or behind the lens
  // plane (radial-tangential), or beyond the angle where the distortion stops being monotonic.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& point) const;
  // The same with the 2x3 derivative of the pixel by the point.
  std::optional<Eigen::Vector2d> project(const Eigen::Vector3d& point,
                                         Eigen::Matrix<double, 2, 3>& jacobian) const;
  // Unit ray of a pixel; nothing where the distortion cannot be inverted.
  std::optional<Eigen::Vector3d> unproject(const Eigen::Vector2d& pixel) const;

 private:
  Eigen::Vector2d distort(const Eigen::Vector2d& normalised, Eigen::Matrix2d& jacobian) const;
  std::optional<Eigen::Vector2d> project_fisheye(const Eigen::Vector3d& point,
                                                 Eigen::Matrix<double, 2, 3>& jacobian) const;

  CameraIntrinsics intrinsics_;
  std::array<double, 8> k_{};
  double max_radius_squared_ = 0;  // radial-tangential: normalised radius up to which r' grows
  double max_angle_ = 0;           // fisheye: the same as an angle, radians
};

}  // namespace gastronaut

#include "calibrate/hand_eye_model.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "calibrate/robust_weight.hpp"

namespace gastronaut {
namespace {

constexpr double kSpacing = 0.002;                           // metres between poses
constexpr double kTurnSpacing = 2 * std::numbers::pi / 180;  // or radians
constexpr double kWiderSpacing = 1.25;       // by what both grow while there are too many poses
constexpr std::size_t kFewestToCompare = 5;  // fixes of a pose; fewer have no majority

std::vector<HandEyePose> gather(const VisualTrack& track, const std::vector<MagneticFix>& fixes,
                                double time_offset, double widening) {
  std::vector<HandEyePose> poses;
  SE3 first;
  bool open = false;
  for (const MagneticFix& fix : fixes) {
    const double time = fix.time + time_offset;
    if (!track.covers(time)) {
      open = false;
      continue;
    }
    const SE3 camera = track.at(time).map_T_camera;
    if (!open || (camera.translation - first.translation).norm() > widening * kSpacing ||
        angle_between(camera.rotation, first.rotation) > widening * kTurnSpacing) {
      poses.emplace_back();
      first = camera;
      open = true;
    }
    poses.back().fixes.push_back(fix);
  }
  return poses;
}

// Turns the row's two rotations to be about the vectors of `basis`, of nearly the same plane.
void express_in(const Eigen::Matrix<double, 3, 2>& basis, HandEyeRow& row) {
  const Eigen::Matrix2d onto = basis.transpose() * row.basis;
  Matrix5d turn = Matrix5d::Identity();
  // The nearest rotation, for `onto` is singular where a wrong fix is at right angles.
  turn.bottomRightCorner<2, 2>() =
      Eigen::Rotation2Dd(std::atan2(onto(1, 0) - onto(0, 1), onto.trace())).toRotationMatrix();
  row.jacobian = turn * row.jacobian;
  row.residual = turn * row.residual;
  row.covariance = turn * row.covariance * turn.transpose();
  row.basis = basis;
}

// Component by component.
Vector5d median(const std::vector<HandEyeRow>& rows) {
  Vector5d result;
  std::vector<double> values(rows.size());
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  for (int i = 0; i < 5; ++i) {
    std::transform(rows.begin(), rows.end(), values.begin(),
                   [i](const HandEyeRow& row) { return row.residual(i); });
    std::nth_element(values.begin(), middle, values.end());
    result(i) = *middle;
  }
  return result;
}

}  // namespace

VisualTrack::VisualTrack(std::vector<VisualFrame> frames, double most_gap) {
  for (std::size_t i = 1; i < frames.size(); ++i) {
    const VisualFrame& from = frames[i - 1];
    const VisualFrame& to = frames[i];
    const double gap = to.time - from.time;
    if (gap <= 0 || gap > most_gap) continue;
    pieces_.push_back({from.time, to.time, from.map_T_camera,
                       (from.map_T_camera.inverse() * to.map_T_camera).log() / gap});
  }
}

const VisualTrack::Piece& VisualTrack::nearest(double time) const {
  const auto after = std::upper_bound(pieces_.begin(), pieces_.end(), time,
                                      [](double t, const Piece& piece) { return t < piece.begin; });
  if (after == pieces_.begin()) return *after;
  const auto before = std::prev(after);
  return after != pieces_.end() && after->begin - time < time - before->end ? *after : *before;
}

bool VisualTrack::covers(double time) const {
  if (pieces_.empty()) return false;
  const Piece& piece = nearest(time);
  return time >= piece.begin && time <= piece.end;
}

VisualTrack::Sample VisualTrack::at(double time) const {
  const Piece& piece = nearest(time);
  return {piece.map_T_camera * SE3::exp((time - piece.begin) * piece.velocity), piece.velocity};
}

std::vector<HandEyePose> gather_poses(const VisualTrack& track,
                                      const std::vector<MagneticFix>& fixes, double time_offset,
                                      std::size_t most) {
  double widening = 1;
  std::vector<HandEyePose> poses = gather(track, fixes, time_offset, widening);
  // Gaps alone may cut more often than that, but not for ever: then every so many are kept.
  constexpr double kWidest = 100;
  while (poses.size() > most && widening < kWidest) {
    widening *= kWiderSpacing;
    poses = gather(track, fixes, time_offset, widening);
  }
  std::vector<HandEyePose> kept;
  for (std::size_t i = 0; i < std::min(most, poses.size()); ++i) {
    kept.push_back(std::move(poses[i * poses.size() / std::min(most, poses.size())]));
  }
  return kept;
}

HandEye stepped(const HandEye& hand_eye, const HandEyeVector& step) {
  HandEye result = hand_eye;
  result.centre += step.segment<3>(kCentreAt);
  result.axis =
      so3_exp(perpendicular_basis(hand_eye.axis) * step.segment<2>(kAxisAt)) * hand_eye.axis;
  result.axis.normalize();
  result.rig_T_map.rotation =
      (so3_exp(step.segment<3>(kMapRotationAt)) * hand_eye.rig_T_map.rotation).normalized();
  result.rig_T_map.translation += step.segment<3>(kMapTranslationAt);
  result.scale *= std::exp(step(kLogScaleAt));
  result.time_offset += step(kTimeOffsetAt);
  return result;
}

HandEyeRow make_row(const HandEye& hand_eye, const VisualTrack::Sample& camera,
                    const MagneticFix& fix) {
  const Eigen::Matrix3d rig_R_map = hand_eye.rig_T_map.rotation.toRotationMatrix();
  const Eigen::Matrix3d rig_R_camera = rig_R_map * camera.map_T_camera.rotation.toRotationMatrix();
  const Eigen::Vector3d way = rig_R_map * (hand_eye.scale * camera.map_T_camera.translation);
  const Eigen::Vector3d from_map = way + rig_R_camera * hand_eye.centre;
  const Eigen::Vector3d expected = rig_R_camera * hand_eye.axis;
  const Eigen::Vector3d speed = camera.velocity.head<3>();
  const Eigen::Vector3d turn = camera.velocity.tail<3>();

  HandEyeRow row;
  row.position = fix.position;
  row.axis = fix.axis;
  row.basis = perpendicular_basis(fix.axis);
  row.covariance = fix.covariance;
  row.residual << fix.position - from_map - hand_eye.rig_T_map.translation,
      row.basis.transpose() * expected.cross(fix.axis);
  row.jacobian.block<3, 3>(0, kCentreAt) = rig_R_camera;
  row.jacobian.block<3, 3>(0, kMapRotationAt) = -skew(from_map);
  row.jacobian.block<3, 3>(0, kMapTranslationAt).setIdentity();
  row.jacobian.block<3, 1>(0, kLogScaleAt) = way;
  row.jacobian.block<3, 1>(0, kTimeOffsetAt) =
      rig_R_camera * (hand_eye.scale * speed + turn.cross(hand_eye.centre));
  row.jacobian.block<2, 2>(3, kAxisAt) =
      row.basis.transpose() * rig_R_camera * perpendicular_basis(hand_eye.axis);
  row.jacobian.block<2, 3>(3, kMapRotationAt) = row.basis.transpose();
  row.jacobian.block<2, 1>(3, kTimeOffsetAt) = row.basis.transpose() * rig_R_camera * turn;
  return row;
}

HandEyeRow make_row(const HandEye& hand_eye, const VisualTrack& track, const HandEyePose& pose) {
  // About one basis: near -z those of neighbouring axes are turned against each other.
  const auto basis = perpendicular_basis(pose.fixes[pose.fixes.size() / 2].axis);
  std::vector<HandEyeRow> rows;
  for (const MagneticFix& fix : pose.fixes) {
    rows.push_back(make_row(hand_eye, track.at(fix.time + hand_eye.time_offset), fix));
    express_in(basis, rows.back());
  }
  if (rows.size() >= kFewestToCompare) {
    const Vector5d middle = median(rows);
    for (HandEyeRow& row : rows) {
      const Vector5d off = row.residual - middle;
      row.weight = robust_weight(std::sqrt(off.dot(row.covariance.llt().solve(off))));
    }
  }
  HandEyeRow mean;
  mean.axis.setZero();
  double total = 0;
  for (const HandEyeRow& row : rows) {
    mean.jacobian += row.weight * row.jacobian;
    mean.residual += row.weight * row.residual;
    mean.covariance += row.weight * row.weight * row.covariance;
    mean.position += row.weight * row.position;
    mean.axis += row.weight * row.axis;
    total += row.weight;
  }
  mean.jacobian /= total;
  mean.residual /= total;
  mean.covariance /= total * total;
  mean.position /= total;
  mean.axis.normalize();
  mean.basis = basis;
  return mean;
}

}  // namespace gastronaut

#include "occupancy_mapper/occupancy_map.hpp"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

namespace gastronaut::occupancy {
namespace {

constexpr double kMicroseconds = 1e6;
// visual_slam numbers its surfels from 0, and sets aside room for two million.
constexpr std::int32_t kMostSurfels = 1 << 23;
constexpr std::size_t kMostViewpoints = 65535;
// A similarity between two frames counts as found when so many surfels agree on it, in voxels RMS:
// rounding to voxels alone gives half a voxel.
constexpr std::size_t kLeastPairs = 100;
constexpr double kLargestResidual = 1;

Eigen::Vector3d transformed(const Eigen::Matrix4d& similarity, const Eigen::Vector3d& point) {
  return similarity.topLeftCorner<3, 3>() * point + similarity.topRightCorner<3, 1>();
}

SE3 transformed(const Eigen::Matrix4d& similarity, const SE3& pose) {
  const Eigen::Matrix3d scaled = similarity.topLeftCorner<3, 3>();
  const Eigen::Quaterniond rotation(Eigen::Matrix3d(scaled / std::cbrt(scaled.determinant())));
  return {(rotation * pose.rotation).normalized(), transformed(similarity, pose.translation)};
}

}  // namespace

OccupancyMap::OccupancyMap(const OccupancyOptions& options)
    : options_(options), tree_(options.resolution) {
  const PinholeGrid& camera = options.camera;
  if (!(options.resolution > 0) || !(options.farthest > options.resolution) ||
      !(options.pose_age > 0) || camera.width < 1 || camera.height < 1 || !(camera.fx > 0) ||
      !(camera.fy > 0)) {
    throw std::invalid_argument(
        "occupancy map: resolution, reach, pose age and the camera must be more than nothing");
  }
}

Eigen::Vector3d OccupancyMap::in_voxels(const Eigen::Vector3d& position) const {
  return position.array() / options_.resolution + kSpaceSide / 2;
}

std::optional<VoxelIndex> OccupancyMap::voxel_of(const Eigen::Vector3d& position) const {
  const Eigen::Vector3d place = in_voxels(position);
  // The outermost voxels are nobody's: Place tells by zeros that there is none.
  if (!((place.array() >= 1).all() && (place.array() < kSpaceSide - 1).all())) return std::nullopt;
  return VoxelIndex(place.array().floor().cast<int>());
}

void OccupancyMap::add_pose(std::int64_t utime, int map_version, const SE3& map_T_camera) {
  if (!voxel_of(map_T_camera.translation)) return;
  poses_.push_back({utime, map_version, map_T_camera});
  forget_old_poses(utime);
}

void OccupancyMap::forget_old_poses(std::int64_t now) {
  const std::int64_t oldest = now - std::llround(options_.pose_age * kMicroseconds);
  while (!poses_.empty() && poses_.front().utime < oldest) poses_.pop_front();
}

// Whether the surfel is in the picture and turned towards it; not whether something hides it.
bool OccupancyMap::sees(const Pose& pose, const MapSurfel& surfel) const {
  const Eigen::Vector3d from_camera =
      surfel.position.cast<double>() - pose.map_T_camera.translation;
  if (!(from_camera.dot(surfel.normal.cast<double>()) < 0)) return false;
  const Eigen::Vector3d point = pose.map_T_camera.rotation.conjugate() * from_camera;
  if (!(point.z() > 0) || point.norm() > options_.farthest) return false;
  const PinholeGrid& camera = options_.camera;
  const double u = camera.fx * point.x() / point.z() + camera.cx;
  const double v = camera.fy * point.y() / point.z() + camera.cy;
  return u >= -0.5 && u < camera.width - 0.5 && v >= -0.5 && v < camera.height - 0.5;
}

std::uint16_t OccupancyMap::viewpoint_at(const Eigen::Vector3d& position) {
  const VoxelIndex voxel = *voxel_of(position);
  const auto [entry, is_new] = viewpoint_in_.try_emplace(
      {voxel.x() / kBlockSide, voxel.y() / kBlockSide, voxel.z() / kBlockSide}, 0);
  if (is_new && viewpoints_.size() < kMostViewpoints) {
    viewpoints_.push_back(position);
    entry->second = static_cast<std::uint16_t>(viewpoints_.size());
  }
  return entry->second;
}

// That of the newest pose that sees it, or else the remembered one; 0: there is none.
std::uint16_t OccupancyMap::find_viewpoint(const MapSurfel& surfel) {
  for (auto pose = poses_.rbegin(); pose != poses_.rend(); ++pose) {
    if (pose->map_version == map_version_ && sees(*pose, surfel)) {
      return viewpoint_at(pose->map_T_camera.translation);
    }
  }
  return remembered_viewpoint(surfel);
}

std::uint16_t OccupancyMap::remembered_viewpoint(const MapSurfel& surfel) {
  const Eigen::Vector3d position = surfel.position.cast<double>();
  const std::uint16_t number = memory_.space.viewpoint_near(*voxel_of(position));
  if (number == 0) return 0;
  const Eigen::Vector3d& viewpoint = memory_.viewpoints[number - 1U];
  const bool faces_it = (viewpoint - position).dot(surfel.normal.cast<double>()) > 0;
  return faces_it ? viewpoint_at(viewpoint) : 0;
}

// The voxel's line of sight.
void OccupancyMap::look(const VoxelIndex& voxel, std::uint16_t viewpoint) {
  std::uint16_t& present = space_.viewpoint_of(voxel);
  if (present != 0 || viewpoint == 0) return;
  const Eigen::Vector3d to = in_voxels(viewpoints_[viewpoint - 1U]);
  const double length = (to - voxel.cast<double>()).norm() * options_.resolution;
  // What was moved so far that nothing could be seen: no line of sight is longer than those made.
  if (length > options_.farthest + kBlockSide * options_.resolution) return;
  present = viewpoint;
  space_.add_sight(voxel, to);
}

void OccupancyMap::enter(Place& place, const VoxelIndex& voxel) {
  for (int axis = 0; axis < 3; ++axis) {
    place.voxel[static_cast<std::size_t>(axis)] = static_cast<std::uint16_t>(voxel[axis]);
  }
  space_.add_surfel(voxel);
}

void OccupancyMap::leave(Place& place) {
  if (!place.has_voxel()) return;
  const VoxelIndex voxel = place.index();
  const std::uint16_t viewpoint = space_.viewpoint_of(voxel);
  if (space_.remove_surfel(voxel) && viewpoint != 0) {
    space_.remove_sight(voxel, in_voxels(viewpoints_[viewpoint - 1U]));
  }
  place.voxel = {};
}

// From the frame before to that of `change`, by surfels that were in the one and are in the other.
std::optional<Eigen::Matrix4d> OccupancyMap::fit_similarity(const MapChange& change) const {
  Eigen::Matrix3Xd before(3, change.changed.size());
  Eigen::Matrix3Xd after(3, change.changed.size());
  Eigen::Index pairs = 0;
  for (const MapSurfel& surfel : change.changed) {
    if (surfel.id < 0 || static_cast<std::size_t>(surfel.id) >= places_.size()) continue;
    const Place& place = places_[static_cast<std::size_t>(surfel.id)];
    if (!place.has_voxel() || !voxel_of(surfel.position.cast<double>())) continue;
    before.col(pairs) =
        (place.index().cast<double>().array() + 0.5 - kSpaceSide / 2) * options_.resolution;
    after.col(pairs) = surfel.position.cast<double>();
    ++pairs;
  }
  if (pairs < static_cast<Eigen::Index>(kLeastPairs)) return std::nullopt;
  before.conservativeResize(3, pairs);
  after.conservativeResize(3, pairs);
  const Eigen::Matrix4d similarity = Eigen::umeyama(before, after, true);
  const Eigen::Matrix3Xd fitted = (similarity.topLeftCorner<3, 3>() * before).colwise() +
                                  similarity.topRightCorner<3, 1>().eval();
  const double rms = std::sqrt((fitted - after).squaredNorm() / static_cast<double>(pairs));
  if (!(rms <= kLargestResidual * options_.resolution)) return std::nullopt;
  return similarity;
}

void OccupancyMap::change_frame(const MapChange& change) {
  const std::optional<Eigen::Matrix4d> similarity = fit_similarity(change);
  const std::vector<Eigen::Vector3d> old_viewpoints = std::exchange(viewpoints_, {});
  if (!similarity && space_.size() > memory_.space.size()) {
    memory_ = {std::exchange(space_, {}), old_viewpoints};
  }
  space_.clear();
  tree_.clear();
  viewpoint_in_.clear();
  std::vector<std::uint16_t> renamed(old_viewpoints.size() + 1, 0);
  if (similarity) {
    for (std::size_t i = 0; i < old_viewpoints.size(); ++i) {
      const Eigen::Vector3d position = transformed(*similarity, old_viewpoints[i]);
      if (voxel_of(position)) renamed[i + 1] = viewpoint_at(position);
    }
  }
  for (Place& place : places_) place = {{}, renamed[place.viewpoint]};
  for (Pose& pose : poses_) {
    if (!similarity || pose.map_version != map_version_ || pose.map_version == change.map_version) {
      continue;
    }
    pose.map_T_camera = transformed(*similarity, pose.map_T_camera);
    if (voxel_of(pose.map_T_camera.translation)) pose.map_version = change.map_version;
  }
}

MapChangeReport OccupancyMap::apply(const MapChange& change) {
  MapChangeReport report;
  forget_old_poses(change.utime);
  if (change.reset) {
    change_frame(change);
  } else {
    // The map stayed where it was; the camera may have been found elsewhere in it.
    for (Pose& pose : poses_) {
      if (pose.map_version == map_version_) pose.map_version = change.map_version;
    }
  }
  map_version_ = change.map_version;
  for (const std::int32_t id : change.removed) {
    if (id < 0 || static_cast<std::size_t>(id) >= places_.size()) continue;
    Place& place = places_[static_cast<std::size_t>(id)];
    leave(place);
    place = {};
  }
  for (const MapSurfel& surfel : change.changed) {
    const std::optional<VoxelIndex> voxel = voxel_of(surfel.position.cast<double>());
    if (!voxel || surfel.id < 0 || surfel.id >= kMostSurfels) {
      ++report.unusable;
      continue;
    }
    const auto id = static_cast<std::size_t>(surfel.id);
    if (id >= places_.size()) places_.resize(id + 1);
    Place& place = places_[id];
    if (place.viewpoint == 0) place.viewpoint = find_viewpoint(surfel);
    if (!surfel.is_stable) {
      leave(place);
      continue;
    }
    if (place.viewpoint == 0) ++report.unseen;
    if (!place.has_voxel() || place.index() != *voxel) {
      leave(place);
      enter(place, *voxel);
    }
    look(*voxel, place.viewpoint);
  }
  return report;
}

std::optional<double> OccupancyMap::clearance() const {
  if (poses_.empty() || poses_.back().map_version != map_version_) return std::nullopt;
  const auto distance = space_.distance_to_wall(in_voxels(poses_.back().map_T_camera.translation));
  if (!distance) return std::nullopt;
  return *distance * options_.resolution;
}

std::optional<double> OccupancyMap::coverage() const {
  const Boundary boundary = space_.boundary();
  const std::int64_t all = boundary.wall + boundary.frontier;
  if (all == 0) return std::nullopt;
  return static_cast<double>(boundary.wall) / static_cast<double>(all);
}

const OccupancyTree& OccupancyMap::tree() {
  space_.take_changes([this](const VoxelIndex& lowest, const BlockState& state) {
    tree_.set_block(lowest, state);
  });
  return tree_;
}

}  // namespace gastronaut::occupancy

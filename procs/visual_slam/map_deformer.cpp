#include "visual_slam/map_deformer.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

namespace gastronaut::slam {
namespace {

constexpr double kMicroseconds = 1e6;  // a second
// Points of a keyframe across the picture and down: those that a pin holds, and those of a loop.
constexpr int kPinColumns = 3;
constexpr int kPinRows = 2;
constexpr int kLoopColumns = 8;
constexpr int kLoopRows = 6;

// The middles of columns x rows cells of the picture that have depth, camera frame.
struct Sample {
  std::size_t pixel = 0;
  Eigen::Vector3d point;
};
std::vector<Sample> samples_of(const Frame& frame, int columns, int rows) {
  std::vector<Sample> samples;
  const PinholeGrid& grid = frame.grid;
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < columns; ++column) {
      const int u = (2 * column + 1) * grid.width / (2 * columns);
      const int v = (2 * row + 1) * grid.height / (2 * rows);
      const auto depth = static_cast<double>(frame.depth.at(u, v));
      if (!(depth > 0) || !std::isfinite(depth)) continue;
      samples.push_back(
          {static_cast<std::size_t>(v) * static_cast<std::size_t>(grid.width) +
               static_cast<std::size_t>(u),
           depth * Eigen::Vector3d((u - grid.cx) / grid.fx, (v - grid.cy) / grid.fy, 1)});
    }
  }
  return samples;
}

double mean_distance(const std::vector<Sample>& samples) {
  if (samples.empty()) return 0;
  double sum = 0;
  for (const Sample& sample : samples) sum += sample.point.z();
  return sum / static_cast<double>(samples.size());
}

// Whether a motion of these points tells that of the camera: they are not along one line.
bool are_spread(const std::vector<Sample>& samples, double distance) {
  if (samples.size() < 3) return false;
  Eigen::Matrix3Xd points(3, std::ssize(samples));
  for (std::size_t i = 0; i < samples.size(); ++i) {
    points.col(static_cast<Eigen::Index>(i)) = samples[i].point;
  }
  points.colwise() -= points.rowwise().mean().eval();
  const Eigen::Matrix3d scatter = points * points.transpose() / static_cast<double>(samples.size());
  constexpr double kLeast = 0.03;  // of the distance, in the second direction
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d>(scatter, Eigen::EigenvaluesOnly)
             .eigenvalues()(1) > kLeast * kLeast * distance * distance;
}

double worst_std(const Eigen::Matrix3d& covariance) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(covariance, Eigen::EigenvaluesOnly);
  return std::sqrt(std::max(solver.eigenvalues()(2), 0.0));
}

// A node that hardly moves what is around it holds still, so that what is far from a bend need not
// be touched.
void hold_still(DeformationGraph& graph) {
  constexpr double kStill = 1e-3;  // of the spacing
  for (std::size_t n = 0; n < graph.nodes().size(); ++n) {
    const DeformationNode& node = graph.nodes()[n];
    const double turn = (node.affine - Eigen::Matrix3d::Identity()).norm();
    if (node.translation.norm() < kStill * graph.spacing() && turn < kStill) {
      graph.set_motion(n, Eigen::Matrix3d::Identity(), Eigen::Vector3d::Zero());
    }
  }
}

}  // namespace

MapDeformer::MapDeformer(const MapDeformerOptions& options) : options_(options) {
  DeformationGraph({}, graph_options());  // which refuses impossible options
  if (!(options.loop_std > 0) || !(options.pin_floor > 0) || options.pins_to_bend < 1 ||
      options.most_pins < options.pins_to_bend) {
    throw std::invalid_argument(
        "map deformer: loop_std and pin_floor must be positive, pins_to_bend at least 1 and "
        "most_pins no less");
  }
}

DeformationGraphOptions MapDeformer::graph_options() const {
  DeformationGraphOptions options;
  options.spacing = options_.spacing * options_.working_distance;
  options.time_reach = options_.time_reach;
  return options;
}

void MapDeformer::add(const Frame& keyframe, const SE3& map_T_camera, bool is_known_surface,
                      const std::optional<KeyframePin>& pin) {
  const std::vector<Sample> samples = samples_of(keyframe, kPinColumns, kPinRows);
  if (samples.empty()) return;
  const double distance = mean_distance(samples);
  add_nodes(keyframe, map_T_camera, distance, is_known_surface);
  if (!are_spread(samples, distance)) return;
  newest_ = {keyframe.utime, map_T_camera, distance, {}};
  for (const Sample& sample : samples) newest_.points.push_back(sample.point);
  const auto interval = std::llround(options_.pin_interval * kMicroseconds);
  if (!pin || (!pinned_.empty() && keyframe.utime - pinned_.back().keyframe.utime < interval)) {
    return;
  }
  pinned_.push_back({newest_, *pin});
  thin_pins();
}

void MapDeformer::add_nodes(const Frame& keyframe, const SE3& map_T_camera, double distance,
                            bool is_known_surface) {
  const DeformationGraphOptions options = graph_options();
  const std::int64_t reach = std::llround(options.time_reach * kMicroseconds);
  const double spacing2 = options.spacing * options.spacing;
  // Twice as dense as nodes may be.
  const auto cells = [&](int pixels, double focal) {
    const double extent = distance * pixels / focal;
    return std::clamp(static_cast<int>(std::ceil(2 * extent / options.spacing)), 1, pixels);
  };
  const PinholeGrid& grid = keyframe.grid;
  for (const Sample& sample :
       samples_of(keyframe, cells(grid.width, grid.fx), cells(grid.height, grid.fy))) {
    const Eigen::Vector3d position = map_T_camera * sample.point;
    const TimeSpan now = TimeSpan::at(keyframe.utime);
    bool is_covered = false;
    for (DeformationNode& node : nodes_) {
      if ((node.position - position).squaredNorm() >= spacing2) continue;
      if (!is_known_surface && node.seen.gap(now) > reach) continue;
      node.seen.first = std::min(node.seen.first, keyframe.utime);
      node.seen.last = std::max(node.seen.last, keyframe.utime);
      is_covered = true;
    }
    if (!is_covered) nodes_.push_back({.position = position, .seen = now});
  }
}

// The map has no more room than this for what pins say: of two that are nearest to each other, the
// newer one stays.
void MapDeformer::thin_pins() {
  if (std::ssize(pinned_) <= options_.most_pins) return;
  double least = std::numeric_limits<double>::infinity();
  auto oldest = pinned_.begin();
  for (auto older = pinned_.begin(); older != pinned_.end(); ++older) {
    for (auto newer = older + 1; newer != pinned_.end(); ++newer) {
      const double apart =
          (older->keyframe.map_T_camera.translation - newer->keyframe.map_T_camera.translation)
              .squaredNorm();
      if (apart >= least) continue;
      least = apart;
      oldest = older;
    }
  }
  pinned_.erase(oldest);
}

bool MapDeformer::is_displaced(const SE3& map_T_camera, const LoopMatch& match) const {
  const std::vector<Sample> samples = samples_of(match.keyframe, kLoopColumns, kLoopRows);
  if (samples.empty()) return false;
  double shift = 0;
  double variance = 0;
  for (const Sample& sample : samples) {
    shift += (match.map_T_camera * sample.point - map_T_camera * sample.point).norm();
    Eigen::Matrix<double, 3, 6> jacobian;  // of the twist in the camera's frame
    jacobian << Eigen::Matrix3d::Identity(), -skew(sample.point);
    variance += (jacobian * match.covariance * jacobian.transpose()).trace();
  }
  const auto count = static_cast<double>(samples.size());
  const double least =
      std::max(options_.least_loop, options_.least_loop_std * match.keyframe.relative_std);
  return shift / count > std::max(least * mean_distance(samples),
                                  options_.least_sigmas * std::sqrt(variance / count));
}

bool MapDeformer::is_off_pins() const {
  const auto is_off = [this](const Pinned& pinned) {
    const Eigen::Vector3d& position = pinned.pin.map_T_camera.translation;
    return (position - pinned.keyframe.map_T_camera.translation).norm() >
           std::max(options_.least_shift * pinned.keyframe.distance,
                    options_.least_sigmas * worst_std(pinned.pin.covariance.topLeftCorner<3, 3>()));
  };
  return std::ssize(pinned_) >= options_.pins_to_bend &&
         std::all_of(pinned_.end() - options_.pins_to_bend, pinned_.end(), is_off);
}

std::vector<DeformationConstraint> MapDeformer::constraints_of_pins() const {
  const double floor = options_.pin_floor * options_.working_distance;
  std::vector<DeformationConstraint> constraints;
  for (const Pinned& pinned : pinned_) {
    const SE3& to = pinned.pin.map_T_camera;
    const Eigen::Matrix3d rotation = to.rotation.toRotationMatrix();
    const auto share = static_cast<double>(pinned.keyframe.points.size());
    for (const Eigen::Vector3d& point : pinned.keyframe.points) {
      Eigen::Matrix<double, 3, 6> jacobian;  // translation in the map's frame, rotation in camera's
      jacobian << Eigen::Matrix3d::Identity(), -rotation * skew(point);
      const Eigen::Matrix3d covariance = jacobian * pinned.pin.covariance * jacobian.transpose() +
                                         floor * floor * Eigen::Matrix3d::Identity();
      DeformationConstraint& constraint = constraints.emplace_back();
      constraint.source = pinned.keyframe.map_T_camera * point;
      constraint.source_seen = TimeSpan::at(pinned.keyframe.utime);
      constraint.destination = to * point;
      // All points of a keyframe say one thing.
      constraint.information = covariance.inverse() / share;
    }
  }
  return constraints;
}

DeformationTask MapDeformer::bend_to_pins() const {
  return {pinned_.back().keyframe.utime, DeformationKind::kFrame, false, nodes_, graph_options(),
          {constraints_of_pins(), {}}};
}

DeformationTask MapDeformer::close_loop(const SE3& map_T_camera, const LoopMatch& match,
                                        const SurfelArrays& surfels) const {
  const Frame& keyframe = match.keyframe;
  const double std = options_.loop_std * options_.working_distance;
  DeformationProblem problem;
  for (const Sample& sample : samples_of(keyframe, kLoopColumns, kLoopRows)) {
    const std::int32_t id = match.old.surfel.values[sample.pixel];
    if (id < 0) continue;
    DeformationConstraint& constraint = problem.constraints.emplace_back();
    constraint.source = map_T_camera * sample.point;
    constraint.source_seen = TimeSpan::at(keyframe.utime);
    constraint.destination = match.map_T_camera * sample.point;
    constraint.destination_seen = old_span(surfels, id, keyframe.utime);
    constraint.information = Eigen::Matrix3d::Identity() / (std * std);
  }
  problem.pins = constraints_of_pins();
  if (problem.pins.empty()) {
    // Nothing says where the whole map is: the old part stays.
    for (DeformationConstraint pin : problem.constraints) {
      pin.source = pin.destination;
      pin.source_seen = *pin.destination_seen;
      pin.destination_seen.reset();
      problem.pins.push_back(pin);
    }
  }
  return {
      keyframe.utime,  match.is_global ? DeformationKind::kGlobalLoop : DeformationKind::kLocalLoop,
      false,           nodes_,
      graph_options(), std::move(problem)};
}

// The layer that is there from before, as far as it is not the new one.
TimeSpan MapDeformer::old_span(const SurfelArrays& surfels, std::int32_t id,
                               std::int64_t now) const {
  const std::int64_t reach = std::llround(options_.time_reach * kMicroseconds);
  const auto k = static_cast<std::size_t>(id);
  const std::int64_t first = surfels.initialised[k];
  return {first, std::max(first, std::min(surfels.updated[k], now - reach))};
}

DeformationTask MapDeformer::follow_wall(const SE3& map_T_camera, const LoopMatch& match,
                                         const SurfelArrays& surfels) const {
  const Frame& keyframe = match.keyframe;
  constexpr double kAcross = 3;  // so much less is told of where a patch is in its plane
  const double std = options_.loop_std * options_.working_distance;
  DeformationProblem problem;
  for (const WallPatch& patch : match.wall) {
    const std::int32_t id = match.old.surfel.values[patch.pixel];
    if (id < 0) continue;
    const Eigen::Vector3d normal = match.map_T_camera.rotation * patch.normal;
    const Eigen::Matrix3d along = normal * normal.transpose();
    DeformationConstraint& constraint = problem.constraints.emplace_back();
    constraint.source = match.map_T_camera * patch.in_map;
    constraint.source_seen = old_span(surfels, id, keyframe.utime);
    constraint.destination = map_T_camera * patch.seen;
    constraint.information =
        (along + (Eigen::Matrix3d::Identity() - along) / (kAcross * kAcross)) / (std * std);
    DeformationConstraint& pin = problem.pins.emplace_back(constraint);
    pin.source = pin.destination;
    pin.source_seen = TimeSpan::at(keyframe.utime);
  }
  return {keyframe.utime, DeformationKind::kFrame, true,
          nodes_,         graph_options(),         std::move(problem)};
}

MapDeformation solve(DeformationTask task, const DeformationSolverOptions& options) {
  DeformationGraph graph(std::move(task.nodes), task.graph_options);
  DeformationReport report = DeformationSolver(options).solve(task.problem, graph);
  hold_still(graph);
  return {task.utime,       0,
          task.kind,        task.is_wall,
          std::move(graph), static_cast<int>(task.problem.constraints.size()),
          std::move(report)};
}

SE3 MapDeformer::follow(const MapDeformation& bend) {
  const DeformationGraph& graph = bend.graph;
  for (DeformationNode& node : nodes_) node.position = graph.moved(node.position, node.seen);
  for (Pinned& pinned : pinned_) {
    const SE3 motion = follow(graph, pinned.keyframe);
    // Where the wall has gone since, the pin would have had the camera as well.
    if (bend.is_wall) pinned.pin.map_T_camera = motion * pinned.pin.map_T_camera;
  }
  return follow(graph, newest_);
}

// The camera goes with what it saw; three points of which are as good as rigid.
SE3 MapDeformer::follow(const DeformationGraph& graph, Keyframe& keyframe) {
  const Eigen::Index count = std::ssize(keyframe.points);
  SE3 motion;
  if (count == 0) return motion;
  Eigen::Matrix3Xd before(3, count);
  Eigen::Matrix3Xd after(3, count);
  for (Eigen::Index i = 0; i < count; ++i) {
    before.col(i) = keyframe.map_T_camera * keyframe.points[static_cast<std::size_t>(i)];
    after.col(i) = graph.moved(before.col(i), TimeSpan::at(keyframe.utime));
  }
  if (before == after) return motion;
  const Eigen::Matrix4d fit = Eigen::umeyama(before, after, false);
  motion.rotation = Eigen::Quaterniond(Eigen::Matrix3d(fit.topLeftCorner<3, 3>())).normalized();
  motion.translation = fit.topRightCorner<3, 1>();
  keyframe.map_T_camera = motion * keyframe.map_T_camera;
  return motion;
}

void MapDeformer::transform(const Similarity& similarity, bool keeps_pins) {
  for (DeformationNode& node : nodes_) node.position = similarity * node.position;
  const auto move = [&similarity](Keyframe& keyframe) {
    keyframe.map_T_camera = similarity * keyframe.map_T_camera;
    keyframe.distance *= similarity.scale;
    for (Eigen::Vector3d& point : keyframe.points) point *= similarity.scale;
  };
  move(newest_);
  if (!keeps_pins) pinned_.clear();
  for (Pinned& pinned : pinned_) move(pinned.keyframe);
}

void MapDeformer::join(MapDeformer older) {
  older.nodes_.insert(older.nodes_.end(), nodes_.begin(), nodes_.end());
  older.pinned_.insert(older.pinned_.end(), pinned_.begin(), pinned_.end());
  nodes_ = std::move(older.nodes_);
  pinned_ = std::move(older.pinned_);
}

void MapDeformer::restart(const SurfelArrays& surfels) {
  pinned_.clear();
  newest_ = {};
  nodes_ = DeformationGraph::sample(surfels, graph_options()).nodes();
}

}  // namespace gastronaut::slam

#include "evaluate/point_constancy.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "evaluate/trajectory_errors.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr int kPointsAcross = 32;  // of the reference picture
constexpr std::size_t kFewestObservations = 5;
constexpr std::size_t kFewestPoints = 10;  // of a reference, for a contrast
// A point is hidden, or its wall has moved, where the true depth differs by more than this share;
// neighbouring pixels that differ by more lie on two sides of an edge.
constexpr double kDepthTolerance = 0.02;

// The pixel at the upper left of (u, v) and the weights of the four around it.
struct Corner {
  int u;
  int v;
  double right;
  double below;
};

std::optional<Corner> corner_of(double u, double v, int width, int height) {
  if (!(u >= 0 && v >= 0 && u < width - 1 && v < height - 1)) return std::nullopt;
  const int left = static_cast<int>(u);
  const int top = static_cast<int>(v);
  return Corner{left, top, u - left, v - top};
}

double blend(const Corner& corner, double upper_left, double upper_right, double lower_left,
             double lower_right) {
  return (1 - corner.below) * ((1 - corner.right) * upper_left + corner.right * upper_right) +
         corner.below * ((1 - corner.right) * lower_left + corner.right * lower_right);
}

// True depth along the ray (x, y, 1); nothing at edges and where there is none.
std::optional<double> depth_along(const DepthPicture& truth, double x, double y) {
  const auto corner =
      corner_of(truth.fx * x + truth.cx, truth.fy * y + truth.cy, truth.width, truth.height);
  if (!corner) return std::nullopt;
  const float* upper =
      truth.depth.data() + static_cast<std::ptrdiff_t>(corner->v) * truth.width + corner->u;
  const float* lower = upper + truth.width;
  const auto [least, most] = std::minmax({upper[0], upper[1], lower[0], lower[1]});
  if (!(least > 0) || most - least > kDepthTolerance * static_cast<double>(most)) {
    return std::nullopt;
  }
  return blend(*corner, upper[0], upper[1], lower[0], lower[1]);
}

std::optional<Corner> corner_with_data(const ConstancyFrame& frame, double u, double v) {
  const auto corner = corner_of(u, v, frame.grid.width, frame.grid.height);
  if (!corner) return std::nullopt;
  const std::uint8_t* upper = frame.pictures.front().row(corner->v) + corner->u;
  const std::uint8_t* lower = frame.pictures.front().row(corner->v + 1) + corner->u;
  if (upper[0] == 0 || upper[1] == 0 || lower[0] == 0 || lower[1] == 0) return std::nullopt;
  return corner;
}

double sample(const Levels& picture, const Corner& corner) {
  const std::uint8_t* upper = picture.row(corner.v) + corner.u;
  const std::uint8_t* lower = picture.row(corner.v + 1) + corner.u;
  return blend(corner, upper[0], upper[1], lower[0], lower[1]);
}

// Standard deviation divided by the mean.
double variation(const std::vector<double>& values) {
  const Statistics all = statistics(values);
  return all.mean > 0 ? all.std / all.mean : 0;
}

double median(const std::vector<double>& values) { return statistics(values).median; }

}  // namespace

void PointConstancy::add(const ConstancyFrame& frame) {
  while (!followed_.empty() && frame.utime > followed_.front().utime + kFollowedFor) {
    settle(followed_.front());
    followed_.erase(followed_.begin());
  }
  for (Reference& reference : followed_) follow(frame, reference.points);
  if (followed_.empty() || frame.utime >= followed_.back().utime + kReferencePeriod) start(frame);
}

void PointConstancy::finish() {
  for (const Reference& reference : followed_) settle(reference);
  followed_.clear();
}

void PointConstancy::start(const ConstancyFrame& frame) {
  Reference reference{frame.utime, {}};
  const double step = static_cast<double>(frame.grid.width) / kPointsAcross;
  const int rows = static_cast<int>(frame.grid.height / step);
  for (int row = 0; row < rows; ++row) {
    for (int column = 0; column < kPointsAcross; ++column) {
      const Eigen::Vector3d ray((step * (column + 0.5) - frame.grid.cx) / frame.grid.fx,
                                (step * (row + 0.5) - frame.grid.cy) / frame.grid.fy, 1);
      const auto depth = depth_along(frame.truth, ray.x(), ray.y());
      if (!depth) continue;
      Point point;
      point.row = row;
      point.column = column;
      point.position = frame.rig_T_camera * Eigen::Vector3d(*depth * ray);
      point.values.resize(spreads_.size());
      reference.points.push_back(std::move(point));
    }
  }
  follow(frame, reference.points);
  std::erase_if(reference.points, [](const Point& point) { return point.values.front().empty(); });
  followed_.push_back(std::move(reference));
}

void PointConstancy::follow(const ConstancyFrame& frame, std::vector<Point>& points) const {
  const SE3 camera_T_rig = frame.rig_T_camera.inverse();
  for (Point& point : points) {
    const Eigen::Vector3d seen = camera_T_rig * point.position;
    if (!(seen.z() > 0)) continue;
    const double x = seen.x() / seen.z();
    const double y = seen.y() / seen.z();
    const auto depth = depth_along(frame.truth, x, y);
    if (!depth || std::abs(*depth - seen.z()) > kDepthTolerance * seen.z()) continue;
    const auto corner = corner_with_data(frame, frame.grid.fx * x + frame.grid.cx,
                                         frame.grid.fy * y + frame.grid.cy);
    if (!corner) continue;
    for (std::size_t kind = 0; kind < point.values.size(); ++kind) {
      point.values[kind].push_back(sample(frame.pictures[kind], *corner));
    }
    const double distance = seen.norm();
    point.nearest = point.nearest > 0 ? std::min(point.nearest, distance) : distance;
    point.farthest = std::max(point.farthest, distance);
  }
}

void PointConstancy::settle(const Reference& reference) {
  std::vector<std::vector<double>> means(spreads_.size());
  const Point* last = nullptr;  // that was seen often enough
  for (const Point& point : reference.points) {
    if (point.values.front().size() < kFewestObservations) continue;
    const bool neighbours =
        last != nullptr && last->row == point.row && last->column + 1 == point.column;
    distance_ratios_.push_back(point.farthest / point.nearest);
    for (std::size_t kind = 0; kind < spreads_.size(); ++kind) {
      spreads_[kind].push_back(variation(point.values[kind]));
      means[kind].push_back(statistics(point.values[kind]).mean);
      if (!neighbours) continue;
      const double pair = variation({means[kind].end() - 2, means[kind].end()});
      local_contrasts_squared_[kind].push_back(2 * pair *
                                               pair);  // 2: variation() divides by 2, not 1
    }
    last = &point;
  }
  if (means.front().empty()) return;
  ++references_;
  if (means.front().size() < kFewestPoints) return;
  for (std::size_t kind = 0; kind < spreads_.size(); ++kind) {
    contrasts_[kind].push_back(variation(means[kind]));
  }
}

std::vector<Constancy> PointConstancy::constancies() const {
  std::vector<Constancy> result;
  for (std::size_t kind = 0; kind < spreads_.size(); ++kind) {
    result.push_back({median(spreads_[kind]), median(contrasts_[kind]),
                      std::sqrt(statistics(local_contrasts_squared_[kind]).mean)});
  }
  return result;
}

double PointConstancy::distance_ratio() const { return median(distance_ratios_); }

}  // namespace gastronaut::evaluation

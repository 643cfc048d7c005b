#include "virtual_rig/vessel_network.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "numerics/counter_random.hpp"
#include "virtual_rig/random_streams.hpp"

namespace gastronaut {
namespace {

constexpr float kCell = 0.0015F;       // metres
constexpr double kStep = 0.0007;       // metres walked in one segment
constexpr double kThickest = 0.00036;  // metres, radius of a trunk
constexpr double kThinnest = 0.00006;  // a twig ends here
constexpr float kSoftEdge = 1.3F;      // radii from the middle to where nothing is seen any more
constexpr int kMostGenerations = 4;
constexpr double kBranchesPerMetre = 130;

// The wall's vertices in cells, to come back to the surface after every step.
class NearestVertex {
 public:
  explicit NearestVertex(const TriangleMesh& wall) : wall_(wall) {
    Eigen::Vector3f low = wall.vertices.front();
    Eigen::Vector3f high = low;
    for (const auto& vertex : wall.vertices) {
      low = low.cwiseMin(vertex);
      high = high.cwiseMax(vertex);
    }
    grid_ = CellGrid(low, high);
    buckets_.resize(grid_.size());
    for (std::uint32_t i = 0; i < wall.vertices.size(); ++i) {
      buckets_[grid_.number(grid_.cell_of(wall.vertices[i]))].push_back(i);
    }
  }

  // Nearest vertex within a cell's width; -1: the point has left the wall (an opened organ's rim).
  std::int64_t find(const Eigen::Vector3f& point) const {
    const Eigen::Array3i centre = grid_.cell_of(point);
    std::int64_t best = -1;
    float best_distance = kCell * kCell;
    for (int z = -1; z <= 1; ++z) {
      for (int y = -1; y <= 1; ++y) {
        for (int x = -1; x <= 1; ++x) {
          const Eigen::Array3i cell = centre + Eigen::Array3i(x, y, z);
          if (!grid_.contains(cell)) continue;
          for (const std::uint32_t i : buckets_[grid_.number(cell)]) {
            const float distance = (wall_.vertices[i] - point).squaredNorm();
            if (distance < best_distance) {
              best_distance = distance;
              best = i;
            }
          }
        }
      }
    }
    return best;
  }

 private:
  const TriangleMesh& wall_;
  CellGrid grid_;
  std::vector<std::vector<std::uint32_t>> buckets_;
};

double wall_area(const TriangleMesh& wall) {
  double area = 0;
  for (const Triangle& t : wall.triangles) {
    const Eigen::Vector3f& a = wall.vertices[t[0]];
    area +=
        0.5 * static_cast<double>((wall.vertices[t[1]] - a).cross(wall.vertices[t[2]] - a).norm());
  }
  return area;
}

struct Sprout {
  Eigen::Vector3f point;
  Eigen::Vector3f heading;  // unit, in the wall
  double radius;
  double length;
  int generation;
};

// A trunk comes up from below the wall: it is not seen at once, metres.
constexpr double kRise = 0.006;

Eigen::Vector3f in_wall(const Eigen::Vector3f& direction, const Eigen::Vector3f& normal) {
  return (direction - normal.dot(direction) * normal).normalized();
}

Eigen::Vector3f turned(const Eigen::Vector3f& heading, const Eigen::Vector3f& normal,
                       double angle) {
  return static_cast<float>(std::cos(angle)) * heading +
         static_cast<float>(std::sin(angle)) * normal.cross(heading);
}

}  // namespace

CellGrid::CellGrid(const Eigen::Vector3f& low, const Eigen::Vector3f& high)
    : low_(low), cells_(((high - low).array() / kCell).floor().cast<int>() + 1) {}

Eigen::Array3i CellGrid::cell_of(const Eigen::Vector3f& point) const {
  return ((point - low_).array() / kCell).floor().cast<int>();
}

std::size_t CellGrid::number(const Eigen::Array3i& cell) const {
  const auto n = cell.cast<std::size_t>();
  const auto cells = cells_.cast<std::size_t>();
  return (n.z() * cells.y() + n.y()) * cells.x() + n.x();
}

VesselNetwork::VesselNetwork(const TriangleMesh& wall, double density, std::uint64_t seed) {
  const CounterRandom random(seed, stream_id(RandomStream::kVessels));
  std::uint64_t n = 0;
  const NearestVertex nearest(wall);
  const double wanted = density * wall_area(wall);
  double grown = 0;
  std::vector<Sprout> sprouts;
  while (grown < wanted) {
    if (sprouts.empty()) {
      const auto root =
          static_cast<std::size_t>(random.uniform(n++) * static_cast<double>(wall.vertices.size()));
      const Eigen::Vector3f direction(static_cast<float>(random.normal(n)),
                                      static_cast<float>(random.normal(n + 1)),
                                      static_cast<float>(random.normal(n + 2)));
      n += 3;
      sprouts.push_back({wall.vertices[root], in_wall(direction, wall.normals[root]),
                         kThickest * (0.55 + 0.45 * random.uniform(n)),
                         0.035 + 0.035 * random.uniform(n + 1), 0});
      n += 2;
    }
    Sprout sprout = sprouts.back();
    sprouts.pop_back();
    double curl = 0;
    double radius = sprout.radius;
    const int steps = static_cast<int>(sprout.length / kStep);
    for (int step = 0; step < steps; ++step) {
      const double walked = step * kStep;
      // The turn itself wanders: bends, not jitter.
      curl = 0.8 * curl + 0.07 * random.normal(n++);
      const std::int64_t at =
          nearest.find(sprout.point + static_cast<float>(kStep) * sprout.heading);
      if (at < 0) break;
      const Eigen::Vector3f& vertex = wall.vertices[static_cast<std::size_t>(at)];
      const Eigen::Vector3f& normal = wall.normals[static_cast<std::size_t>(at)];
      Eigen::Vector3f next = sprout.point + static_cast<float>(kStep) * sprout.heading;
      next -= normal.dot(next - vertex) * normal;
      const double next_radius = sprout.radius * (1 - 0.6 * walked / sprout.length);
      if (next_radius < kThinnest) break;
      const double risen = sprout.generation > 0 ? 1 : std::min(1.0, walked / kRise);
      const double strength = risen * (0.4 + 0.6 * std::min(1.0, radius / kThickest));
      segments_.push_back({sprout.point, next - sprout.point, static_cast<float>(radius),
                           static_cast<float>(next_radius), static_cast<float>(strength)});
      grown += kStep;
      radius = next_radius;
      sprout.point = next;
      sprout.heading = in_wall(turned(sprout.heading, normal, curl), normal);
      if (sprout.generation < kMostGenerations && random.uniform(n++) < kBranchesPerMetre * kStep) {
        const double side = random.uniform(n) < 0.5 ? -1 : 1;
        const double angle = side * (0.45 + 0.6 * random.uniform(n + 1));
        sprouts.push_back({sprout.point, in_wall(turned(sprout.heading, normal, angle), normal),
                           radius * (0.5 + 0.3 * random.uniform(n + 2)),
                           (sprout.length - walked) * (0.5 + 0.4 * random.uniform(n + 3)),
                           sprout.generation + 1});
        n += 4;
      }
    }
  }
  fill_grid();
}

void VesselNetwork::fill_grid() {
  if (segments_.empty()) return;
  const auto reach = [](const Segment& s) {
    return Eigen::Vector3f::Constant(kSoftEdge * std::max(s.start_radius, s.end_radius)).eval();
  };
  Eigen::Vector3f low = segments_.front().start;
  Eigen::Vector3f high = low;
  for (const Segment& s : segments_) {
    low = low.cwiseMin(s.start.cwiseMin(s.start + s.along) - reach(s));
    high = high.cwiseMax(s.start.cwiseMax(s.start + s.along) + reach(s));
  }
  grid_ = CellGrid(low, high);
  const auto for_cells = [&](const Segment& s, const auto& visit) {
    const Eigen::Array3i from = grid_.cell_of(s.start.cwiseMin(s.start + s.along) - reach(s));
    const Eigen::Array3i to = grid_.cell_of(s.start.cwiseMax(s.start + s.along) + reach(s));
    for (int z = from.z(); z <= to.z(); ++z) {
      for (int y = from.y(); y <= to.y(); ++y) {
        for (int x = from.x(); x <= to.x(); ++x) visit(grid_.number({x, y, z}));
      }
    }
  };
  first_.assign(grid_.size() + 1, 0);
  for (const Segment& s : segments_) for_cells(s, [&](std::size_t cell) { ++first_[cell + 1]; });
  for (std::size_t cell = 1; cell < first_.size(); ++cell) first_[cell] += first_[cell - 1];
  members_.resize(first_.back());
  std::vector<std::uint32_t> next(first_.begin(), first_.end() - 1);
  for (std::uint32_t i = 0; i < segments_.size(); ++i) {
    for_cells(segments_[i], [&](std::size_t cell) { members_[next[cell]++] = i; });
  }
}

float VesselNetwork::at(const Eigen::Vector3f& point) const {
  if (segments_.empty()) return 0;
  const Eigen::Array3i cell = grid_.cell_of(point);
  if (!grid_.contains(cell)) return 0;
  const std::size_t number = grid_.number(cell);
  float seen = 0;
  for (std::uint32_t i = first_[number]; i < first_[number + 1]; ++i) {
    const Segment& s = segments_[members_[i]];
    const Eigen::Vector3f from = point - s.start;
    const float t = std::clamp(from.dot(s.along) / s.along.squaredNorm(), 0.0F, 1.0F);
    const float radius = s.start_radius + t * (s.end_radius - s.start_radius);
    const float outer = kSoftEdge * radius;
    const float distance2 = (from - t * s.along).squaredNorm();
    if (distance2 >= outer * outer) continue;
    const float inner = 0.4F * radius;
    const float x = std::clamp((outer - std::sqrt(distance2)) / (outer - inner), 0.0F, 1.0F);
    seen = std::max(seen, s.strength * x * x * (3 - 2 * x));
  }
  return seen;
}

}  // namespace gastronaut

#include "evaluate/surfel_picture.hpp"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <opencv2/imgproc.hpp>

#include "evaluate/trajectory_errors.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr int kFiner = 2;             // drawn pixels for one of the picture's, each way
constexpr int kBandRows = 32;         // drawn by one thread at a time
constexpr float kLeastRadius = 0.8F;  // pixels: no holes between far surfels
constexpr float kBlendDepth = 3;      // radii behind the nearest disc that still count

struct Disc {
  Eigen::Vector3f centre;  // view frame
  Eigen::Vector3f normal;
  float radius = 0;
  // Pixels that it may cover, ends excluded.
  int left = 0;
  int right = 0;
  int top = 0;
  int bottom = 0;
};

class DiscPainter {
 public:
  explicit DiscPainter(const PinholeGrid& grid)
      : grid_(grid),
        fx_(static_cast<float>(grid.fx)),
        fy_(static_cast<float>(grid.fy)),
        cx_(static_cast<float>(grid.cx)),
        cy_(static_cast<float>(grid.cy)) {}

  // An empty rectangle for what is not to be seen.
  Disc place(const Surfel& surfel, const Eigen::Matrix3f& rotation,
             const Eigen::Vector3f& translation) const {
    Disc disc{rotation * surfel.position + translation, rotation * surfel.normal, surfel.radius};
    const float z = disc.centre.z();
    if (!(z > 2 * disc.radius) || disc.centre.dot(disc.normal) >= 0) return disc;
    disc.radius = std::max(disc.radius, kLeastRadius * z / std::min(fx_, fy_));
    const float nearest =
        z - disc.radius * std::sqrt(std::max(0.0F, 1 - disc.normal.z() * disc.normal.z()));
    if (!(nearest > 0.5F * z)) return disc;
    const auto range = [&](float middle, float f, float c, int size, int& begin, int& end) {
      const float low = f * std::min((middle - disc.radius) / nearest, (middle - disc.radius) / z);
      const float high = f * std::max((middle + disc.radius) / nearest, (middle + disc.radius) / z);
      const auto limit = static_cast<float>(size);
      begin = static_cast<int>(std::clamp(std::ceil(low + c), 0.0F, limit));
      end = static_cast<int>(std::clamp(std::floor(high + c) + 1, 0.0F, limit));
    };
    range(disc.centre.x(), fx_, cx_, grid_.width, disc.left, disc.right);
    range(disc.centre.y(), fy_, cy_, grid_.height, disc.top, disc.bottom);
    return disc;
  }

  // use(u, v, depth, squared distance from the centre over that of the rim).
  template <class Use>
  void each_pixel(const Disc& disc, int top, int bottom, const Use& use) const {
    const float plane = disc.normal.dot(disc.centre);
    const float scale = 1 / (disc.radius * disc.radius);
    for (int v = std::max(disc.top, top); v < std::min(disc.bottom, bottom); ++v) {
      const float y = (static_cast<float>(v) - cy_) / fy_;
      for (int u = disc.left; u < disc.right; ++u) {
        const float x = (static_cast<float>(u) - cx_) / fx_;
        const float slope = disc.normal.x() * x + disc.normal.y() * y + disc.normal.z();
        if (slope >= 0) continue;
        const float depth = plane / slope;
        const float dx = depth * x - disc.centre.x();
        const float dy = depth * y - disc.centre.y();
        const float dz = depth - disc.centre.z();
        const float inside = (dx * dx + dy * dy + dz * dz) * scale;
        if (inside <= 1) use(u, v, depth, inside);
      }
    }
  }

 private:
  PinholeGrid grid_;
  float fx_, fy_, cx_, cy_;
};

Eigen::Vector3f colour_of(const Surfel& surfel) {
  return Eigen::Vector3f(surfel.colour[0], surfel.colour[1], surfel.colour[2]) / 255;
}

// 0 on an even surface, towards 1 where neighbours stand before it: folds get an outline.
float hidden_share(const SurfelDrawing& drawing, int u, int v) {
  constexpr int kReach = 3;       // pixels
  constexpr float kSteepest = 8;  // slope that counts in full
  const float depth = drawing.depth.at(u, v);
  const float across = depth * kReach / static_cast<float>(drawing.grid.fx);
  float sum = 0;
  for (int dv = -1; dv <= 1; ++dv) {
    for (int du = -1; du <= 1; ++du) {
      const int x = u + kReach * du;
      const int y = v + kReach * dv;
      if (x < 0 || y < 0 || x >= drawing.depth.width || y >= drawing.depth.height) continue;
      const float other = drawing.depth.at(x, y);
      if (other > 0) sum += std::clamp((depth - other) / across - 1, 0.0F, kSteepest) / kSteepest;
    }
  }
  return sum / 8;
}

float light_at(const SurfelDrawing& drawing, int u, int v) {
  constexpr float kAmbient = 0.3F;
  constexpr float kOutline = 0.7F;
  const auto coordinate = [](int pixel, double centre, double focal) {
    return static_cast<float>((pixel - centre) / focal);
  };
  const Eigen::Vector3f ray(coordinate(u, drawing.grid.cx, drawing.grid.fx),
                            coordinate(v, drawing.grid.cy, drawing.grid.fy), 1);
  // Up and to the left of the eye, so that what is round looks round.
  const Eigen::Vector3f lamp =
      (-ray.normalized() + Eigen::Vector3f(-0.25F, -0.35F, 0)).normalized();
  return (kAmbient + (1 - kAmbient) * std::max(0.0F, drawing.normal.at(u, v).dot(lamp))) *
         (1 - kOutline * hidden_share(drawing, u, v));
}

// Blue, green, red, 0..1.
Eigen::Vector3f pixel_colour(const SurfelDrawing& drawing, Look look, float value_limit, int u,
                             int v) {
  const Eigen::Vector3f kMaterial(0.72F, 0.79F, 0.90F);
  const float light = drawing.light.at(u, v);
  const float little_light = 0.65F + 0.35F * light;
  const Eigen::Vector3f& normal = drawing.normal.at(u, v);
  switch (look) {
    case Look::kShape:
      return kMaterial * light;
    case Look::kColour:
      return drawing.colour.at(u, v).reverse() * little_light;
    case Look::kValue: {
      const auto [blue, green, red] = value_colour(drawing.value.at(u, v) / value_limit);
      return Eigen::Vector3f(blue, green, red) / 255 * little_light;
    }
    case Look::kNormals:
      return Eigen::Vector3f(-normal.z(), -normal.y(), normal.x()) * 0.5F +
             Eigen::Vector3f::Constant(0.5F);
  }
  return kMaterial;
}

// visit(u, v) of each pixel of the drawing that shows a surfel, rows in parallel.
template <class Visit>
void each_seen_pixel(const SurfelDrawing& drawing, const Visit& visit) {
  parallel_for_chunks(static_cast<std::size_t>(drawing.grid.height), kBandRows,
                      [&](std::size_t begin, std::size_t end) {
                        for (int v = static_cast<int>(begin); v < static_cast<int>(end); ++v) {
                          for (int u = 0; u < drawing.grid.width; ++u) {
                            if (drawing.depth.at(u, v) > 0) visit(u, v);
                          }
                        }
                      });
}

class LinePainter {
 public:
  LinePainter(const SurfelDrawing& drawing, Plane<Eigen::Vector3f>& picture)
      : drawing_(drawing), picture_(picture), view_T_world_(drawing.world_T_view.inverse()) {}

  void draw(const Line& line) {
    half_width_ = line.half_width * kFiner;
    colour_ = Eigen::Vector3f(line.colour[0], line.colour[1], line.colour[2]) / 255;
    for (std::size_t i = 1; i < line.points.size(); ++i) {
      draw(view_T_world_ * line.points[i - 1], view_T_world_ * line.points[i]);
    }
    // The start is thick.
    if (!line.points.empty()) dot(view_T_world_ * line.points.front(), 3 * half_width_);
  }

 private:
  static constexpr double kNearest = 1e-4;  // metres

  Eigen::Vector2d project(const Eigen::Vector3d& point) const {
    const PinholeGrid& grid = drawing_.grid;
    return {grid.fx * point.x() / point.z() + grid.cx, grid.fy * point.y() / point.z() + grid.cy};
  }

  void draw(const Eigen::Vector3d& from, const Eigen::Vector3d& to) {
    if (from.z() < kNearest || to.z() < kNearest) return;
    const double length = (project(to) - project(from)).norm();
    const double most = drawing_.grid.width + drawing_.grid.height;
    const int steps = static_cast<int>(std::min(length, most)) + 1;
    for (int step = 0; step <= steps; ++step) {
      dot(from + (to - from) * step / steps, half_width_);
    }
  }

  void dot(const Eigen::Vector3d& point, int radius) {
    if (point.z() < kNearest) return;
    const Eigen::Vector2d centre = project(point);
    if (!(centre.cwiseAbs().maxCoeff() < 1e6)) return;
    const auto u = static_cast<int>(std::lround(centre.x()));
    const auto v = static_cast<int>(std::lround(centre.y()));
    for (int dv = -radius; dv <= radius; ++dv) {
      for (int du = -radius; du <= radius; ++du) {
        const int x = u + du;
        const int y = v + dv;
        if (du * du + dv * dv > radius * radius || x < 0 || y < 0 || x >= picture_.width ||
            y >= picture_.height) {
          continue;
        }
        const float surface = drawing_.depth.at(x, y);
        if (surface > 0 && static_cast<double>(surface) < point.z()) continue;
        picture_.at(x, y) = colour_;
      }
    }
  }

  const SurfelDrawing& drawing_;
  Plane<Eigen::Vector3f>& picture_;
  SE3 view_T_world_;
  Eigen::Vector3f colour_;
  int half_width_ = 0;
};

struct Box {
  Eigen::Vector3d low = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector3d high = -low;
};

// Between the 0.5 and 99.5 % of each coordinate: stray surfels must not make the map small.
Box box_of(std::span<const Surfel> surfels, const Eigen::Matrix3d& view_R_world) {
  Box box;
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> values;
    for (const Surfel& surfel : surfels) {
      values.push_back(view_R_world.row(axis).dot(surfel.position.cast<double>()));
    }
    box.low[axis] = quantile(values, 0.005);
    box.high[axis] = quantile(values, 0.995);
  }
  return box;
}

// Looks along `forward` with the longer extent of the map across.
Viewpoint framed(std::span<const Surfel> surfels, std::span<const Eigen::Vector3d> path,
                 const Eigen::Vector3d& forward, int width, int most_height) {
  const Eigen::Matrix<double, 3, 2> across = perpendicular_basis(forward);
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  Eigen::Matrix2d spread = Eigen::Matrix2d::Zero();
  for (const Surfel& surfel : surfels) {
    const Eigen::Vector2d place = across.transpose() * surfel.position.cast<double>();
    mean += place;
    spread += place * place.transpose();
  }
  const auto count = static_cast<double>(surfels.size());
  spread = spread / count - mean * mean.transpose() / (count * count);
  Eigen::Vector3d right =
      across * Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(spread).eigenvectors().col(1);
  // Of the two ways up, the one that has the rig's z up, or else its x to the right.
  const Eigen::Vector3d down = forward.cross(right);
  constexpr double kLevel = 0.1;
  if (std::abs(down.z()) > kLevel ? down.z() > 0 : right.x() < 0) right = -right;

  Viewpoint view;
  Eigen::Matrix3d view_R_world;
  view_R_world << right.transpose(), forward.cross(right).transpose(), forward.transpose();
  Box box = box_of(surfels, view_R_world);
  for (const Eigen::Vector3d& point : path) {
    box.low = box.low.cwiseMin(view_R_world * point);
    box.high = box.high.cwiseMax(view_R_world * point);
  }
  // From six times its size away it looks nearly as in a drawing, without vanishing points.
  constexpr double kAway = 6;
  constexpr double kMargin = 1.1;
  constexpr double kMarginBelow = 1.22;  // room for a scale
  const Eigen::Vector3d size = (box.high - box.low).cwiseMax(1e-6);
  const double away = kAway * size.maxCoeff();
  const double nearest = away - size.z() / 2;
  const double focal = nearest / kMargin *
                       std::min(width / size.x(), most_height / size.y() * kMargin / kMarginBelow);
  const int height =
      std::clamp(static_cast<int>(kMarginBelow * focal * size.y() / nearest), 1, most_height);
  view.grid = {width, height, focal, focal, (width - 1) / 2.0, (height - 1) / 2.0};
  const Eigen::Vector3d middle = (box.low + box.high) / 2;
  view.world_T_view = {Eigen::Quaterniond(Eigen::Matrix3d(view_R_world.transpose())),
                       view_R_world.transpose() * (middle - Eigen::Vector3d(0, 0, away))};
  return view;
}

}  // namespace

PinholeGrid finer(const PinholeGrid& grid, int factor) {
  const double shift = (factor - 1) / 2.0;
  return {grid.width * factor, grid.height * factor,     grid.fx * factor,
          grid.fy * factor,    grid.cx * factor + shift, grid.cy * factor + shift};
}

SurfelDrawing draw_surfels(std::span<const Surfel> surfels, std::span<const float> values,
                           const Viewpoint& viewpoint) {
  const PinholeGrid grid = finer(viewpoint.grid, kFiner);
  SurfelDrawing drawing{grid,
                        viewpoint.world_T_view,
                        Plane<float>(grid.width, grid.height),
                        Plane<Eigen::Vector3f>(grid.width, grid.height, Eigen::Vector3f::Zero()),
                        Plane<Eigen::Vector3f>(grid.width, grid.height, Eigen::Vector3f::Zero()),
                        Plane<float>(grid.width, grid.height),
                        Plane<float>(grid.width, grid.height)};
  const DiscPainter painter(grid);
  const SE3 view_T_world = viewpoint.world_T_view.inverse();
  const Eigen::Matrix3f rotation = view_T_world.rotation.toRotationMatrix().cast<float>();
  const Eigen::Vector3f translation = view_T_world.translation.cast<float>();
  std::vector<Disc> discs(surfels.size());
  constexpr std::size_t kChunk = 8192;
  parallel_for_chunks(discs.size(), kChunk, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      discs[i] = painter.place(surfels[i], rotation, translation);
    }
  });
  const auto bands = static_cast<std::size_t>((grid.height + kBandRows - 1) / kBandRows);
  std::vector<std::vector<std::uint32_t>> of_band(bands);
  for (std::size_t i = 0; i < discs.size(); ++i) {
    if (discs[i].left >= discs[i].right || discs[i].top >= discs[i].bottom) continue;
    for (int band = discs[i].top / kBandRows; band <= (discs[i].bottom - 1) / kBandRows; ++band) {
      of_band[static_cast<std::size_t>(band)].push_back(static_cast<std::uint32_t>(i));
    }
  }
  run_chunks(bands, [&](std::size_t band) {
    const int top = static_cast<int>(band) * kBandRows;
    const int bottom = std::min(top + kBandRows, grid.height);
    for (const std::uint32_t i : of_band[band]) {
      painter.each_pixel(discs[i], top, bottom, [&](int u, int v, float depth, float) {
        float& nearest = drawing.depth.at(u, v);
        if (nearest == 0 || depth < nearest) nearest = depth;
      });
    }
    Plane<float> weights(grid.width, bottom - top);
    for (const std::uint32_t i : of_band[band]) {
      const Disc& disc = discs[i];
      const Eigen::Vector3f colour = colour_of(surfels[i]);
      const float value = values.empty() ? 0 : values[i];
      const float reach = kBlendDepth * disc.radius;
      painter.each_pixel(disc, top, bottom, [&](int u, int v, float depth, float inside) {
        if (depth > drawing.depth.at(u, v) + reach) return;
        constexpr float kRim = 1e-3F;  // a pixel that has only rims is not without a colour
        const float weight = (1 - inside) * (1 - inside) + kRim;
        weights.at(u, v - top) += weight;
        drawing.normal.at(u, v) += weight * disc.normal;
        drawing.colour.at(u, v) += weight * colour;
        drawing.value.at(u, v) += weight * value;
      });
    }
    for (int v = top; v < bottom; ++v) {
      for (int u = 0; u < grid.width; ++u) {
        const float weight = weights.at(u, v - top);
        if (!(weight > 0)) continue;
        drawing.normal.at(u, v).normalize();
        drawing.colour.at(u, v) /= weight;
        drawing.value.at(u, v) /= weight;
      }
    }
  });
  each_seen_pixel(drawing, [&](int u, int v) { drawing.light.at(u, v) = light_at(drawing, u, v); });
  return drawing;
}

ColourPicture paint(const SurfelDrawing& drawing, Look look, float value_limit,
                    std::span<const Line> lines) {
  const PinholeGrid& grid = drawing.grid;
  Plane<Eigen::Vector3f> fine(grid.width, grid.height, Eigen::Vector3f::Ones());
  each_seen_pixel(drawing, [&](int u, int v) {
    fine.at(u, v) = pixel_colour(drawing, look, value_limit, u, v);
  });
  LinePainter painter(drawing, fine);
  for (const Line& line : lines) painter.draw(line);

  ColourPicture picture(grid.width / kFiner, grid.height / kFiner);
  const auto average_row = [&](int v) {
    for (int u = 0; u < picture.width; ++u) {
      Eigen::Vector3f sum = Eigen::Vector3f::Zero();
      for (int dv = 0; dv < kFiner; ++dv) {
        for (int du = 0; du < kFiner; ++du) sum += fine.at(kFiner * u + du, kFiner * v + dv);
      }
      const Eigen::Vector3f mean = sum / (kFiner * kFiner);
      for (int k = 0; k < 3; ++k) {
        picture.at(u, v)[static_cast<std::size_t>(k)] =
            static_cast<std::uint8_t>(255 * std::clamp(mean[k], 0.0F, 1.0F) + 0.5F);
      }
    }
  };
  run_chunks(static_cast<std::size_t>(picture.height),
             [&](std::size_t row) { average_row(static_cast<int>(row)); });
  return picture;
}

double covered(const SurfelDrawing& drawing) {
  const auto empty = std::count(drawing.depth.values.begin(), drawing.depth.values.end(), 0.0F);
  return 1 - static_cast<double>(empty) / static_cast<double>(drawing.depth.size());
}

std::array<std::uint8_t, 3> value_colour(float share) {
  static const std::vector<std::array<std::uint8_t, 3>> colours = [] {
    std::vector<std::uint8_t> levels(256);
    for (std::size_t i = 0; i < levels.size(); ++i) levels[i] = static_cast<std::uint8_t>(i);
    std::vector<std::array<std::uint8_t, 3>> table(levels.size());
    cv::Mat target(1, 256, CV_8UC3, table.data());
    cv::applyColorMap(cv::Mat(1, 256, CV_8U, levels.data()), target, cv::COLORMAP_VIRIDIS);
    return table;
  }();
  return colours[static_cast<std::size_t>(std::lround(255 * std::clamp(share, 0.0F, 1.0F)))];
}

std::vector<Viewpoint> outside_views(std::span<const Surfel> surfels,
                                     std::span<const Eigen::Vector3d> path, std::size_t count,
                                     int width, int most_height) {
  std::vector<Viewpoint> views;
  if (surfels.empty()) return views;
  constexpr std::size_t kMostSurfels = 20000;  // to judge by
  std::vector<Surfel> some;
  for (std::size_t i = 0; i < surfels.size(); i += surfels.size() / kMostSurfels + 1) {
    some.push_back(surfels[i]);
  }
  struct Candidate {
    Eigen::Vector3d forward;
    double facing = 0;  // square metres, as seen from there
  };
  std::vector<Candidate> candidates;
  constexpr int kDirections = 200;
  for (int i = 0; i < kDirections; ++i) {
    // A spiral from pole to pole spreads points evenly over the sphere.
    const double z = 1 - (2 * i + 1.0) / kDirections;
    const double angle = i * std::numbers::pi * (3 - std::sqrt(5.0));
    const double r = std::sqrt(1 - z * z);
    Candidate candidate{{r * std::cos(angle), r * std::sin(angle), z}};
    for (const Surfel& surfel : some) {
      const double radius = static_cast<double>(surfel.radius);
      candidate.facing +=
          radius * radius * std::max(0.0, -candidate.forward.dot(surfel.normal.cast<double>()));
    }
    candidates.push_back(candidate);
  }
  std::stable_sort(candidates.begin(), candidates.end(),
                   [](const auto& a, const auto& b) { return a.facing > b.facing; });
  const double apart = std::cos(50 * std::numbers::pi / 180);
  std::vector<Eigen::Vector3d> chosen;
  for (const Candidate& candidate : candidates) {
    if (chosen.size() == count) break;
    const bool is_new = std::none_of(
        chosen.begin(), chosen.end(),
        [&](const Eigen::Vector3d& other) { return other.dot(candidate.forward) > apart; });
    if (!is_new) continue;
    chosen.push_back(candidate.forward);
    views.push_back(framed(some, path, candidate.forward, width, most_height));
  }
  return views;
}

}  // namespace gastronaut::evaluation

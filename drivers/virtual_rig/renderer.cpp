#include "virtual_rig/renderer.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "numerics/parallel.hpp"

namespace gastronaut {
namespace {

constexpr int kWidth = RayScene::kWidth;
// Rays are traced in square blocks of pixels: neighbours meet the same triangles.
constexpr int kBlock = 4;
static_assert(kBlock * kBlock == kWidth);
constexpr std::size_t kLobeSteps = 2048;
// Shadow rays start this far above the wall, metres: more than single precision loses, less than
// any fold.
constexpr float kAboveWall = 2e-5F;
// Highlights dimmer than exp(-this) of their peak are not computed.
constexpr float kDimmestHighlight = 9;
constexpr double kTypicalDistance = 0.03;  // metres

using Lanes = std::array<float, kWidth>;

void set_ray(RTCRay16& ray, std::size_t lane, const Eigen::Vector3f& origin,
             const Eigen::Vector3f& direction, float far) {
  ray.org_x[lane] = origin.x();
  ray.org_y[lane] = origin.y();
  ray.org_z[lane] = origin.z();
  ray.dir_x[lane] = direction.x();
  ray.dir_y[lane] = direction.y();
  ray.dir_z[lane] = direction.z();
  ray.tnear[lane] = 0;
  ray.tfar[lane] = far;
  ray.time[lane] = 0;
  ray.mask[lane] = ~0u;
  ray.id[lane] = 0;
  ray.flags[lane] = 0;
}

}  // namespace

// Pixels of a block: -1 where it hangs over the picture's border.
struct Renderer::Block {
  std::array<std::ptrdiff_t, kWidth> pixel;

  Block(const CameraConfiguration& camera, int first_row, int first_col) {
    for (int i = 0; i < kWidth; ++i) {
      const int row = first_row + i / kBlock;
      const int col = first_col + i % kBlock;
      const bool inside = row < camera.height && col < camera.width;
      pixel[static_cast<std::size_t>(i)] =
          inside ? static_cast<std::ptrdiff_t>(row) * camera.width + col : -1;
    }
  }
};

struct Renderer::Shot {
  Eigen::Matrix3f rotation;  // rig_R_camera
  Eigen::Vector3f position;
  std::vector<Eigen::Vector3f> lights;  // rig frame
  float intensity;                      // led_intensity times gain
  float gain;
  float weight;  // of this shot in the mean
  Fluid fluid;
};

Renderer::Renderer(const CameraConfiguration& camera, const LightsConfiguration& lights,
                   const TriangleMesh& rest, const Tissue& tissue, bool wall_moves)
    : camera_(camera),
      lens_(camera.intrinsics()),
      lobe_(lights.lobe),
      rest_(rest),
      tissue_(tissue),
      wall_(rest),
      scene_(rest, wall_moves) {
  for (int k = 0; k < lights.count; ++k) {
    const double angle = 2 * std::numbers::pi * k / lights.count + lights.phase;
    lights_.push_back(
        (lights.radius * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0)).cast<float>());
  }
  for (int row = 0; row < camera.height; ++row) {
    for (int col = 0; col < camera.width; ++col) {
      const auto ray = lens_.unproject({static_cast<double>(col), static_cast<double>(row)});
      const bool seen = ray && ray->z() > 0;
      rays_.push_back(seen ? Eigen::Vector3f(ray->cast<float>()) : Eigen::Vector3f::Zero());
      vignetting_.push_back(
          seen ? static_cast<float>(std::pow(ray->z(), camera.vignetting_cos_power)) : 0.0F);
    }
  }
  lobe_table_.resize(kLobeSteps + 2);
  for (std::size_t i = 0; i < lobe_table_.size(); ++i) {
    lobe_table_[i] = static_cast<float>(std::pow(static_cast<double>(i) / kLobeSteps, lobe_));
  }
}

void Renderer::move_wall(const TriangleMesh& wall) {
  wall_.normals = wall.normals;
  scene_.move_vertices(wall.vertices);
}

double Renderer::motion_in_pixels(const SE3& from, const SE3& to) const {
  const SE3 to_T_from = to.inverse() * from;
  double longest = 0;
  const int w = camera_.width;
  const int h = camera_.height;
  for (const auto& [col, row] : {std::pair{w / 2, h / 2},
                                 {w / 8, h / 8},
                                 {7 * w / 8, h / 8},
                                 {w / 8, 7 * h / 8},
                                 {7 * w / 8, 7 * h / 8}}) {
    const Eigen::Vector2d pixel(col, row);
    const auto ray = lens_.unproject(pixel);
    if (!ray) continue;
    const auto moved = lens_.project(to_T_from * (kTypicalDistance * *ray));
    if (moved) longest = std::max(longest, (*moved - pixel).norm());
  }
  return longest;
}

template <class Body>
void Renderer::for_blocks(const Body& body) const {
  const int block_rows = (camera_.height + kBlock - 1) / kBlock;
  parallel_for_chunks(static_cast<std::size_t>(block_rows), 1, [&](std::size_t begin, std::size_t) {
    for (int col = 0; col < camera_.width; col += kBlock) {
      body(Block(camera_, static_cast<int>(begin) * kBlock, col));
    }
  });
}

std::vector<float> Renderer::render(const std::vector<SE3>& rig_T_cameras, double gain,
                                    const Fluid& fluid) const {
  std::vector<Shot> shots;
  for (const SE3& pose : rig_T_cameras) {
    Shot shot;
    shot.rotation = pose.rotation.toRotationMatrix().cast<float>();
    shot.position = pose.translation.cast<float>();
    for (const Eigen::Vector3f& light : lights_) {
      shot.lights.push_back(shot.rotation * light + shot.position);
    }
    shot.gain = static_cast<float>(gain);
    shot.intensity = static_cast<float>(gain * camera_.led_intensity);
    shot.weight = 1.0F / static_cast<float>(rig_T_cameras.size());
    shot.fluid = fluid;
    shots.push_back(std::move(shot));
  }
  std::vector<float> picture(rays_.size() * 3, 0.0F);
  for_blocks([&](const Block& block) {
    for (const Shot& shot : shots) render_block(shot, block, picture);
  });
  return picture;
}

void Renderer::render_block(const Shot& shot, const Block& block,
                            std::vector<float>& picture) const {
  const Eigen::Vector3f optical_axis = shot.rotation.col(2);
  RTCRayHit16 hits;
  alignas(64) std::array<int, kWidth> valid{};
  std::array<Eigen::Vector3f, kWidth> direction;
  for (std::size_t i = 0; i < kWidth; ++i) {
    if (block.pixel[i] < 0) continue;
    const auto n = static_cast<std::size_t>(block.pixel[i]);
    if (vignetting_[n] == 0) continue;
    valid[i] = -1;
    direction[i] = shot.rotation * rays_[n];
    set_ray(hits.ray, i, shot.position, direction[i], std::numeric_limits<float>::infinity());
    hits.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
    hits.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
  }
  scene_.intersect(valid.data(), hits);

  std::array<Eigen::Vector3f, kWidth> point;
  std::array<Eigen::Vector3f, kWidth> normal;
  std::array<TissueSample, kWidth> tissue;
  Lanes diffuse{};
  Lanes highlight{};
  for (std::size_t i = 0; i < kWidth; ++i) {
    if (valid[i] == 0 || hits.hit.geomID[i] == RTC_INVALID_GEOMETRY_ID) {
      valid[i] = 0;
      continue;
    }
    const Triangle& corners = wall_.triangles[hits.hit.primID[i]];
    const float u = hits.hit.u[i];
    const float v = hits.hit.v[i];
    const std::array<float, 3> weights = {1 - u - v, u, v};
    Eigen::Vector3f rest_point = Eigen::Vector3f::Zero();
    normal[i].setZero();
    for (std::size_t k = 0; k < 3; ++k) {
      rest_point += weights[k] * rest_.vertices[corners[k]];
      normal[i] += weights[k] * wall_.normals[corners[k]];
    }
    normal[i].normalize();
    point[i] = shot.position + hits.ray.tfar[i] * direction[i];
    tissue[i] = tissue_.sample(corners, weights, rest_point);
  }
  for (const Eigen::Vector3f& light : shot.lights) {
    RTCRay16 shadow;
    alignas(64) std::array<int, kWidth> lit{};
    Lanes cosine{};
    Lanes irradiance{};
    std::array<Eigen::Vector3f, kWidth> to_light;
    for (std::size_t i = 0; i < kWidth; ++i) {
      if (valid[i] == 0) continue;
      const Eigen::Vector3f way = light - point[i];
      const float distance2 = way.squaredNorm();
      to_light[i] = way / std::sqrt(distance2);
      cosine[i] = normal[i].dot(to_light[i]);
      const float emission = -optical_axis.dot(to_light[i]);
      if (cosine[i] <= 0 || emission <= 0) continue;
      const float place = emission * static_cast<float>(kLobeSteps);
      const auto step = static_cast<std::size_t>(place);
      const float lobe = lobe_table_[step] + (place - static_cast<float>(step)) *
                                                 (lobe_table_[step + 1] - lobe_table_[step]);
      irradiance[i] = shot.intensity * lobe / distance2;
      lit[i] = -1;
      const Eigen::Vector3f above = point[i] + kAboveWall * normal[i];
      set_ray(shadow, i, above, light - above, 1);
    }
    scene_.occluded(lit.data(), shadow);
    for (std::size_t i = 0; i < kWidth; ++i) {
      if (lit[i] == 0 || shadow.tfar[i] < 0) continue;
      diffuse[i] += irradiance[i] * cosine[i];
      const Eigen::Vector3f half = (to_light[i] - direction[i]).normalized();
      const Eigen::Vector3f rippled = (normal[i] - tissue[i].ripple).normalized();
      const float aligned = rippled.dot(half);
      if (aligned <= 0) continue;
      const float exponent = tissue[i].exponent;
      // x^e is about exp(e (x - 1)) near x = 1, and smaller elsewhere.
      if (exponent * (1 - aligned) > kDimmestHighlight) continue;
      highlight[i] +=
          irradiance[i] * tissue[i].film * (exponent + 8) / 8 * std::pow(aligned, exponent);
    }
  }
  for (std::size_t i = 0; i < kWidth; ++i) {
    if (block.pixel[i] < 0) continue;
    Eigen::Vector3f light = Eigen::Vector3f::Zero();
    float through = 0;
    if (valid[i] != 0) {
      light = diffuse[i] * tissue[i].albedo + Eigen::Vector3f::Constant(highlight[i]);
      through = std::exp(-2 * shot.fluid.extinction * hits.ray.tfar[i]);
    }
    if (shot.fluid.extinction > 0) {
      light = through * light + (1 - through) * shot.gain * shot.fluid.glow;
    }
    const auto n = static_cast<std::size_t>(block.pixel[i]);
    Eigen::Map<Eigen::Vector3f>(picture.data() + 3 * n) += shot.weight * vignetting_[n] * light;
  }
}

std::vector<float> Renderer::depth(const SE3& rig_T_camera) const {
  const Eigen::Matrix3f rotation = rig_T_camera.rotation.toRotationMatrix().cast<float>();
  const Eigen::Vector3f position = rig_T_camera.translation.cast<float>();
  std::vector<float> depths(rays_.size(), 0.0F);
  for_blocks([&](const Block& block) {
    RTCRayHit16 hits;
    alignas(64) std::array<int, kWidth> valid{};
    for (std::size_t i = 0; i < kWidth; ++i) {
      if (block.pixel[i] < 0) continue;
      // Unit step along the optical axis: the ray's parameter is the depth.
      const std::ptrdiff_t col = block.pixel[i] % camera_.width;
      const std::ptrdiff_t row = block.pixel[i] / camera_.width;
      const Eigen::Vector3d ray((static_cast<double>(col) - camera_.cx) / camera_.fx,
                                (static_cast<double>(row) - camera_.cy) / camera_.fy, 1);
      valid[i] = -1;
      set_ray(hits.ray, i, position, rotation * ray.cast<float>(),
              std::numeric_limits<float>::infinity());
      hits.hit.geomID[i] = RTC_INVALID_GEOMETRY_ID;
      hits.hit.instID[0][i] = RTC_INVALID_GEOMETRY_ID;
    }
    scene_.intersect(valid.data(), hits);
    for (std::size_t i = 0; i < kWidth; ++i) {
      if (valid[i] != 0 && hits.hit.geomID[i] != RTC_INVALID_GEOMETRY_ID) {
        depths[static_cast<std::size_t>(block.pixel[i])] = hits.ray.tfar[i];
      }
    }
  });
  return depths;
}

}  // namespace gastronaut

#include "virtual_rig/renderer.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace gastronaut {
namespace {

constexpr double kSinglePrecision = 1e-5;  // relative, of lengths in the ray tracer
constexpr double kLight = 1e-4;            // relative: single precision and the table of the lobe

// Plane z = distance + slope x in the rig frame, facing the origin; metres.
TriangleMesh plane(double distance, double slope, double half_size) {
  constexpr int kCells = 40;
  TriangleMesh mesh;
  for (int row = 0; row <= kCells; ++row) {
    for (int col = 0; col <= kCells; ++col) {
      const double x = half_size * (2.0 * col / kCells - 1);
      const double y = half_size * (2.0 * row / kCells - 1);
      mesh.vertices.push_back(Eigen::Vector3d(x, y, distance + slope * x).cast<float>());
    }
  }
  constexpr std::uint32_t kStride = kCells + 1;
  for (std::uint32_t row = 0; row < kCells; ++row) {
    for (std::uint32_t col = 0; col < kCells; ++col) {
      const std::uint32_t a = row * kStride + col;
      mesh.triangles.push_back({a, a + kStride, a + 1});
      mesh.triangles.push_back({a + 1, a + kStride, a + kStride + 1});
    }
  }
  compute_normals(mesh);
  return mesh;
}

TriangleMesh sphere(double radius, int cells) {
  TriangleMesh mesh;
  const auto number = [cells](int i, int j) {
    return static_cast<std::uint32_t>(i * 2 * cells + j % (2 * cells));
  };
  for (int i = 0; i <= cells; ++i) {
    for (int j = 0; j < 2 * cells; ++j) {
      const double polar = std::numbers::pi * i / cells;
      const double azimuth = std::numbers::pi * j / cells;
      mesh.vertices.push_back(
          (radius * Eigen::Vector3d(std::sin(polar) * std::cos(azimuth),
                                    std::sin(polar) * std::sin(azimuth), std::cos(polar)))
              .cast<float>());
      if (i == cells) continue;
      mesh.triangles.push_back({number(i, j), number(i, j + 1), number(i + 1, j)});
      mesh.triangles.push_back({number(i, j + 1), number(i + 1, j + 1), number(i + 1, j)});
    }
  }
  compute_normals(mesh);
  return mesh;
}

// Uniform and dull.
OrganConfiguration plain_tissue() {
  OrganConfiguration organ;
  organ.vessels = organ.mucus = organ.variation = 0;
  return organ;
}

CameraConfiguration small_camera() {
  CameraConfiguration camera;
  camera.width = 83;  // hangs over the blocks' borders
  camera.height = 61;
  camera.fx = 43;
  camera.fy = 44;
  camera.cx = 40;
  camera.cy = 31;
  camera.distortion = {-0.15, 0.02, 0.001, -0.002};
  return camera;
}

double depth_at(const std::vector<float>& depth, const CameraConfiguration& camera, int col,
                int row) {
  return static_cast<double>(depth[static_cast<std::size_t>(row * camera.width + col)]);
}

TEST(Renderer, DepthOfATiltedPlaneIsTheAnalyticOne) {
  const CameraConfiguration camera = small_camera();
  const double distance = 0.03;
  const double slope = 0.4;
  const TriangleMesh wall = plane(distance, slope, 0.2);
  const Tissue tissue(plain_tissue(), wall);
  const Renderer renderer(camera, {}, wall, tissue, false);
  const std::vector<float> depth = renderer.depth(SE3());
  for (int row = 0; row < camera.height; ++row) {
    for (int col = 0; col < camera.width; ++col) {
      const double expected = distance / (1 - slope * (col - camera.cx) / camera.fx);
      EXPECT_NEAR(depth_at(depth, camera, col, row), expected, kSinglePrecision * expected);
    }
  }
}

TEST(Renderer, DepthInsideASphereIsTheAnalyticOne) {
  const CameraConfiguration camera = small_camera();
  const double radius = 0.035;
  constexpr int kCells = 300;
  const TriangleMesh wall = sphere(radius, kCells);
  const Tissue tissue(plain_tissue(), wall);
  const Renderer renderer(camera, {}, wall, tissue, false);
  // A chord of the mesh lies within its sagitta of the sphere.
  const double edge = std::numbers::pi * radius / kCells;
  const double sagitta = edge * edge / (4 * radius);
  SE3 pose;
  pose.rotation = so3_exp({0.3, -0.8, 0.2});
  const std::vector<float> depth = renderer.depth(pose);
  for (int row = 0; row < camera.height; ++row) {
    for (int col = 0; col < camera.width; ++col) {
      const Eigen::Vector3d ray((col - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, 1);
      const double expected = radius / ray.norm();
      EXPECT_NEAR(depth_at(depth, camera, col, row), expected,
                  sagitta + kSinglePrecision * expected);
    }
  }
}

TEST(Renderer, BrightnessOfAPlaneFollowsTheImagingEquation) {
  const CameraConfiguration camera = small_camera();
  const LightsConfiguration lights;
  const OrganConfiguration organ = plain_tissue();
  const double distance = 0.03;
  const double gain = 1.3;
  const TriangleMesh wall = plane(distance, 0, 0.2);
  const Tissue tissue(organ, wall);
  const Renderer renderer(camera, lights, wall, tissue, false);
  const std::vector<float> picture = renderer.render({SE3()}, gain, {});
  const CameraModel lens(camera.intrinsics());
  for (int row = 0; row < camera.height; row += 5) {
    for (int col = 0; col < camera.width; col += 5) {
      const Eigen::Vector3d ray = lens.unproject({col, row}).value();
      const Eigen::Vector3d point = ray * distance / ray.z();
      double light = 0;
      for (int k = 0; k < lights.count; ++k) {
        const double angle = 2 * std::numbers::pi * k / lights.count + lights.phase;
        const Eigen::Vector3d led(lights.radius * std::cos(angle), lights.radius * std::sin(angle),
                                  0);
        const double r = (point - led).norm();
        const double cosine = distance / r;  // to the plane's normal and to the optical axis
        light += camera.led_intensity * std::pow(cosine, lights.lobe) / (r * r) * cosine;
      }
      light *= gain * std::pow(ray.z(), camera.vignetting_cos_power);
      for (int channel = 0; channel < 3; ++channel) {
        const double expected = light * organ.albedo[channel];
        const auto n = static_cast<std::size_t>(3 * (row * camera.width + col) + channel);
        EXPECT_NEAR(static_cast<double>(picture[n]), expected, kLight * expected);
      }
    }
  }
}

TEST(Renderer, WhatStandsInTheLightCastsAShadow) {
  const CameraConfiguration camera = small_camera();
  LightsConfiguration one_light;
  one_light.count = 1;
  one_light.radius = 0.006;  // at (6, 0, 0) mm
  one_light.phase = 0;
  TriangleMesh wall = plane(0.03, 0, 0.2);
  const TriangleMesh obstacle = plane(0.015, 0, 0.0015);
  // Half-way, at x = 6 mm: under the lamp, 6 mm beside the ray of the pixel that it shades.
  const auto first = static_cast<std::uint32_t>(wall.vertices.size());
  for (const Eigen::Vector3f& vertex : obstacle.vertices) {
    wall.vertices.emplace_back(vertex + Eigen::Vector3f(0.006F, 0, 0));
  }
  for (const Triangle& t : obstacle.triangles) {
    wall.triangles.push_back({first + t[0], first + t[1], first + t[2]});
  }
  compute_normals(wall);
  const Tissue tissue(plain_tissue(), wall);
  const Renderer renderer(camera, one_light, wall, tissue, false);
  const std::vector<float> picture = renderer.render({SE3()}, 1, {});
  const CameraModel lens(camera.intrinsics());
  const auto red = [&](const Eigen::Vector3d& point) {
    const Eigen::Vector2d pixel = lens.project(point).value();
    return picture[static_cast<std::size_t>(
        3 * (std::lround(pixel.y()) * camera.width + std::lround(pixel.x())))];
  };
  EXPECT_EQ(red({0.006, 0, 0.03}), 0);
  EXPECT_GT(red({-0.006, 0, 0.03}), 0);
}

TEST(Renderer, SeveralPosesGiveTheirMean) {
  const CameraConfiguration camera = small_camera();
  const TriangleMesh wall = plane(0.03, 0, 0.2);
  const Tissue tissue(plain_tissue(), wall);
  const Renderer renderer(camera, {}, wall, tissue, false);
  SE3 moved;
  moved.translation.z() = 0.004;
  const std::vector<float> a = renderer.render({SE3()}, 1, {});
  const std::vector<float> b = renderer.render({moved}, 1, {});
  const std::vector<float> mean = renderer.render({SE3(), moved}, 1, {});
  for (std::size_t i = 0; i < mean.size(); ++i) {
    EXPECT_NEAR(mean[i], (a[i] + b[i]) / 2, kSinglePrecision);
  }
  // A fronto-parallel step of 4 mm at 26 mm: pixels move outwards by that ratio.
  EXPECT_GT(renderer.motion_in_pixels(SE3(), moved), 1);
  EXPECT_LT(renderer.motion_in_pixels(moved, moved), kSinglePrecision);
}

TEST(Renderer, DenseFluidShowsNothingButItsGlow) {
  const CameraConfiguration camera = small_camera();
  const TriangleMesh wall = plane(0.03, 0, 0.2);
  const Tissue tissue(plain_tissue(), wall);
  const Renderer renderer(camera, {}, wall, tissue, false);
  Fluid fluid;
  fluid.extinction = 1000;  // exp(-60) of the wall's light arrives
  fluid.glow = {0.3F, 0.2F, 0.1F};
  const std::vector<float> picture = renderer.render({SE3()}, 1, fluid);
  const auto centre = static_cast<std::size_t>(3 * (31 * camera.width + 40));
  for (int channel = 0; channel < 3; ++channel) {
    EXPECT_NEAR(picture[centre + static_cast<std::size_t>(channel)], fluid.glow[channel],
                kSinglePrecision);
  }
}

TEST(Renderer, SeesTheWallWhereItHasMovedTo) {
  const CameraConfiguration camera = small_camera();
  const TriangleMesh rest = plane(0.03, 0, 0.2);
  const Tissue tissue(plain_tissue(), rest);
  Renderer renderer(camera, {}, rest, tissue, true);
  const double moved = 0.027;
  renderer.move_wall(plane(moved, 0, 0.2));
  EXPECT_NEAR(depth_at(renderer.depth(SE3()), camera, 40, 31), moved, kSinglePrecision * moved);
}

}  // namespace
}  // namespace gastronaut

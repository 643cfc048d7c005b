#include "depth_estimator/front_end.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <vector>

#include "camera/camera_model.hpp"
#include "numerics/parallel.hpp"

namespace gastronaut::perception {
namespace {

CameraConfiguration small_camera() {
  CameraConfiguration camera;
  camera.width = 160;
  camera.height = 120;
  camera.fx = camera.fy = 80;
  camera.cx = 80.4;
  camera.cy = 58.4;
  return camera;
}

// One level a pixel, in all three channels or as `tint` of it.
struct Picture {
  std::vector<std::uint8_t> rgb;
  EncodedPicture encoded(const CameraConfiguration& camera) const {
    return {camera.width, camera.height, 3 * camera.width, PixelFormat::kRgb, rgb};
  }
};
Picture draw(const CameraConfiguration& camera, const std::function<double(int, int)>& level) {
  Picture picture;
  for (int v = 0; v < camera.height; ++v) {
    for (int u = 0; u < camera.width; ++u) {
      for (const double tint : {1.0, 0.7, 0.6}) {
        picture.rgb.push_back(static_cast<std::uint8_t>(std::lround(tint * level(u, v))));
      }
    }
  }
  return picture;
}

// A grain of sharp squares, blurred by a box of the given width.
Picture grain(const CameraConfiguration& camera, int blur_u, int blur_v, double contrast) {
  const auto sharp = [](int u, int v) {
    const auto hash = static_cast<std::uint32_t>(u / 3) * 73856093u ^
                      static_cast<std::uint32_t>(v / 3) * 19349663u;
    return ((hash * 2654435761u) >> 31) != 0u ? 1.0 : 0.0;
  };
  return draw(camera, [=](int u, int v) {
    double sum = 0;
    for (int b = 0; b < blur_v; ++b) {
      for (int a = 0; a < blur_u; ++a) sum += sharp(u + a + 100, v + b + 100);
    }
    return contrast * (90 + 70 * sum / (blur_u * blur_v));
  });
}

LinearPicture see(const CameraConfiguration& camera, const Picture& picture) {
  LinearPicture seen;
  EXPECT_FALSE(FrontEnd(camera).process(picture.encoded(camera), seen));
  return seen;
}

class EveryLens : public ::testing::TestWithParam<LensModel> {
 protected:
  CameraConfiguration camera() const {
    CameraConfiguration camera = small_camera();
    camera.model = GetParam();
    camera.distortion = GetParam() == LensModel::kFisheye
                            ? std::vector<double>{0.02, -0.01, 0.004, -0.001}
                            : std::vector<double>{-0.16, 0.025, 0.0004, -0.0003};
    return camera;
  }
};

// A straight edge in space, as the lens bends it, is straight again.
TEST_P(EveryLens, StraightEdgeIsStraightAgain) {
  const CameraConfiguration configuration = camera();
  const CameraModel lens(configuration.intrinsics());
  constexpr double kSlope = 0.3;
  constexpr double kOffset = 0.35;   // of the edge y = kOffset + kSlope x in normalised coordinates
  constexpr double kSoftness = 1.5;  // pixels
  const Picture picture = draw(configuration, [&](int u, int v) {
    const auto ray = lens.unproject({static_cast<double>(u), static_cast<double>(v)});
    const double beyond = ray->y() / ray->z() - (kOffset + kSlope * ray->x() / ray->z());
    return 100 + 80 * std::tanh(beyond * configuration.fy / kSoftness);
  });
  const LinearPicture seen = see(configuration, picture);
  constexpr double kSubpixel = 0.1;  // fixed-point maps (1/32 pixel) and 8 bits
  int columns = 0;
  for (int u = 4; u < configuration.width - 4; u += 5) {
    const double expected =
        configuration.cy +
        configuration.fy * (kOffset + kSlope * (u - configuration.cx) / configuration.fx);
    if (expected < 3 || expected > configuration.height - 4) continue;
    const int above = static_cast<int>(expected) - 2;
    bool inside = true;
    for (int v = above; v < above + 5; ++v) inside &= (seen.flags.at(u, v) & kOutside) == 0;
    if (!inside) continue;
    ++columns;
    // Where the level crosses the middle between dark and bright.
    constexpr float kMiddle = 70.0F / 255;
    int v = above;
    while (v < above + 5 && seen.green_level.at(u, v) < kMiddle) ++v;
    const float low = seen.green_level.at(u, v - 1);
    const float high = seen.green_level.at(u, v);
    EXPECT_NEAR(v - 1 + static_cast<double>((kMiddle - low) / (high - low)), expected, kSubpixel)
        << u;
  }
  EXPECT_GT(columns, 10);
}

TEST_P(EveryLens, PixelsThatTheLensDoesNotSeeAreOutside) {
  CameraConfiguration configuration = camera();
  // A pinhole camera with so short a focal length wants rays beyond the lens's picture.
  configuration.fx = configuration.fy = 30;
  configuration.distortion.assign(4, 0);
  configuration.distortion[0] = GetParam() == LensModel::kFisheye ? 0.4 : 0.2;
  const CameraModel lens(configuration.intrinsics());
  const LinearPicture seen = see(configuration, grain(configuration, 1, 1, 1));
  for (int v = 0; v < configuration.height; v += 7) {
    for (int u = 0; u < configuration.width; u += 7) {
      const auto pixel = lens.project({(u - configuration.cx) / configuration.fx,
                                       (v - configuration.cy) / configuration.fy, 1});
      const bool inside = pixel && pixel->x() >= 0 && pixel->x() <= configuration.width - 1 &&
                          pixel->y() >= 0 && pixel->y() <= configuration.height - 1;
      EXPECT_EQ((seen.flags.at(u, v) & kOutside) == 0, inside) << u << ", " << v;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(FrontEnd, EveryLens,
                         ::testing::Values(LensModel::kRadialTangential, LensModel::kFisheye));

TEST(FrontEnd, LevelsBecomeLinearLight) {
  CameraConfiguration camera = small_camera();
  const Picture picture = draw(camera, [](int u, int) { return 20 + u; });
  LinearPicture seen = see(camera, picture);
  EXPECT_FLOAT_EQ(seen.light[0].at(100, 60),
                  static_cast<float>(std::pow(120.0 / 255, camera.gamma)));
  EXPECT_FLOAT_EQ(seen.green_level.at(100, 60), 84.0F / 255);
  // A calibrated response takes gamma's place.
  camera.response = {0, 0.1, 1};
  seen = see(camera, picture);
  EXPECT_NEAR(seen.light[0].at(100, 60), 0.1 * 120 / 127.5, 1e-6);
}

// A round picture in a black frame, as endoscopes have, its rim two pixels soft.
TEST(FrontEnd, RimOfARoundPictureIsNoDarkLine) {
  const CameraConfiguration camera = small_camera();
  const LinearPicture seen = see(camera, draw(camera, [](int u, int v) {
                                   const double rim = 50 - std::hypot(u - 80, v - 60);
                                   const double grain = ((u / 3) + (v / 3)) % 2 == 0 ? 1.15 : 0.85;
                                   return 120 * grain * std::clamp(rim / 2 + 0.5, 0.0, 1.0);
                                 }));
  constexpr float kHalfOfTheTissue = 0.5F * 0.7F * 120 / 255;
  for (int v = 0; v < camera.height; ++v) {
    for (int u = 0; u < camera.width; ++u) {
      EXPECT_GT(seen.green_level.at(u, v), kHalfOfTheTissue) << u << ", " << v;
    }
  }
}

TEST(FrontEnd, SaturationIsSaidChannelByChannel) {
  const CameraConfiguration camera = small_camera();
  const LinearPicture seen =
      see(camera, draw(camera, [](int u, int) { return u < 40 ? 255 : 100; }));
  EXPECT_EQ(seen.flags.at(10, 60), kRedSaturated);
  EXPECT_EQ(seen.flags.at(100, 60), 0);
  EXPECT_DOUBLE_EQ(seen.quality.saturated_fraction, 0.25);
  EXPECT_DOUBLE_EQ(seen.quality.dark_fraction, 0);
}

TEST(FrontEnd, SharpnessFallsWithDefocusAndWithMotion) {
  const CameraConfiguration camera = small_camera();
  double last = 1;
  for (const int blur : {1, 3, 5, 9}) {
    const double sharpness = see(camera, grain(camera, blur, blur, 1)).quality.sharpness;
    EXPECT_LT(sharpness, last) << blur;
    last = sharpness;
  }
  const double sharp = see(camera, grain(camera, 1, 1, 1)).quality.sharpness;
  EXPECT_LT(see(camera, grain(camera, 9, 1, 1)).quality.sharpness, 0.7 * sharp);
  EXPECT_LT(see(camera, grain(camera, 1, 9, 1)).quality.sharpness, 0.7 * sharp);
}

TEST(FrontEnd, SharpnessDoesNotDependOnBrightness) {
  const CameraConfiguration camera = small_camera();
  constexpr double kRoundingToLevels = 0.02;
  EXPECT_NEAR(see(camera, grain(camera, 3, 3, 0.5)).quality.sharpness,
              see(camera, grain(camera, 3, 3, 1)).quality.sharpness, kRoundingToLevels);
}

TEST(FrontEnd, BlackWhiteAndVeiledPicturesAreFailuresDimOnesAreNot) {
  const CameraConfiguration camera = small_camera();
  FrontEnd front_end(camera);
  LinearPicture seen;
  const auto failure = [&](const Picture& picture) {
    return front_end.process(picture.encoded(camera), seen).kind;
  };
  const auto even = [](int level) {
    Picture picture;
    picture.rgb.assign(3 * 160 * 120, static_cast<std::uint8_t>(level));
    return picture;
  };
  EXPECT_EQ(failure(even(3)), "black");
  EXPECT_EQ(failure(even(255)), "white");
  EXPECT_EQ(failure(even(120)), "veiled");
  EXPECT_EQ(failure(grain(camera, 2, 2, 0.2)), "");
}

TEST(FrontEnd, SameBytesOnOneThreadAndMany) {
  CameraConfiguration camera = small_camera();
  camera.distortion = {-0.16, 0.025, 0.0004, -0.0003};
  const Picture picture = grain(camera, 3, 3, 1.2);
  set_thread_count(1);
  const LinearPicture one = see(camera, picture);
  set_thread_count(4);
  const LinearPicture many = see(camera, picture);
  set_thread_count(0);
  for (std::size_t c = 0; c < 3; ++c) EXPECT_EQ(one.light[c].values, many.light[c].values);
  EXPECT_EQ(one.green_level.values, many.green_level.values);
  EXPECT_EQ(one.flags.values, many.flags.values);
  EXPECT_EQ(one.quality.sharpness, many.quality.sharpness);
}

}  // namespace
}  // namespace gastronaut::perception

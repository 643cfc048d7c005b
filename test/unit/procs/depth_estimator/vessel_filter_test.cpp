#include "depth_estimator/vessel_filter.hpp"

#include <gtest/gtest.h>
#include <hwy/highway.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <vector>

#include "numerics/parallel.hpp"

namespace gastronaut::perception {
namespace {

Plane<float> draw(int width, int height, const std::function<double(int, int)>& level) {
  Plane<float> picture(width, height);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) picture.at(u, v) = static_cast<float>(level(u, v));
  }
  return picture;
}

Plane<float> respond(const Plane<float>& picture, const VesselFilterOptions& options) {
  Plane<float> response;
  VesselFilter(picture.width, picture.height, options).apply(picture, response);
  return response;
}

constexpr int kSide = 96;
constexpr double kBackground = 0.6;
// Kernels cut at four standard deviations and sampled, interpolation of coarse scales.
constexpr double kDiscretisation = 0.03;

double gaussian_line(double distance, double width) {
  return std::exp(-distance * distance / (2 * width * width));
}

// A line of depth A and Gaussian profile w, smoothed by s: A w / sqrt(w^2 + s^2) deep, so
// s^2 times its second derivative is A w s^2 / (w^2 + s^2)^(3/2); the other eigenvalue is 0.
double line_response(double depth, double width, double scale, double structureness) {
  const double hessian =
      depth * width * scale * scale / std::pow(width * width + scale * scale, 1.5);
  return 1 - std::exp(-hessian * hessian / (2 * structureness * structureness));
}

TEST(VesselFilter, DarkLineAnswersAsTheClosedFormSaysAtEveryScale) {
  constexpr double kWidth = 2;
  constexpr double kDepth = 0.1;
  for (const double scale : {1.0, 1.6, 2.5, 4.0, 6.0, 9.0}) {
    VesselFilterOptions options;
    options.scales = {scale};
    const Plane<float> response = respond(
        draw(kSide, kSide,
             [](int u, int) { return kBackground - kDepth * gaussian_line(u - 48, kWidth); }),
        options);
    EXPECT_NEAR(static_cast<double>(response.at(48, 48)),
                line_response(kDepth, kWidth, scale, options.structureness), kDiscretisation)
        << scale;
  }
}

TEST(VesselFilter, LineAnswersMostAtRootTwoTimesItsWidth) {
  constexpr double kWidth = 2.5;
  const auto at_scale = [&](double scale) {
    VesselFilterOptions options;
    options.scales = {scale};
    return respond(
               draw(kSide, kSide,
                    [&](int u, int) { return kBackground - 0.05 * gaussian_line(u - 48, kWidth); }),
               options)
        .at(48, 48);
  };
  const double best = std::sqrt(2.0) * kWidth;
  EXPECT_GT(at_scale(best), at_scale(0.7 * best));
  EXPECT_GT(at_scale(best), at_scale(1.4 * best));
}

TEST(VesselFilter, ScalesTogetherAreTheirMaximum) {
  const Plane<float> picture = draw(kSide, kSide, [](int u, int v) {
    return kBackground - 0.1 * gaussian_line(u - 20, 1) - 0.1 * gaussian_line(v - 60, 4);
  });
  VesselFilterOptions options;
  const Plane<float> all = respond(picture, options);
  Plane<float> expected(kSide, kSide);
  for (const double scale : VesselFilterOptions().scales) {
    options.scales = {scale};
    const Plane<float> one = respond(picture, options);
    for (std::size_t i = 0; i < one.size(); ++i) {
      expected.values[i] = std::max(expected.values[i], one.values[i]);
    }
  }
  for (std::size_t i = 0; i < all.size(); ++i) EXPECT_EQ(all.values[i], expected.values[i]);
}

TEST(VesselFilter, BrightLineAndFlatPictureAnswerNothing) {
  const Plane<float> bright = respond(
      draw(kSide, kSide, [](int u, int) { return 0.3 + 0.2 * gaussian_line(u - 48, 2); }), {});
  EXPECT_EQ(bright.at(48, 48), 0);
  for (const float level : {0.0F, 0.37F, 1.0F}) {
    const Plane<float> response = respond(Plane<float>(kSide, kSide, level), {});
    // Sums of the kernels' weights, rounded.
    constexpr float kRounding = 1e-6F;
    EXPECT_LT(*std::max_element(response.values.begin(), response.values.end()), kRounding);
  }
}

TEST(VesselFilter, BlobAnswersLessThanALine) {
  const VesselFilterOptions options;
  const Plane<float> blob =
      respond(draw(kSide, kSide,
                   [](int u, int v) {
                     return kBackground - 0.1 * gaussian_line(u - 48, 2) * gaussian_line(v - 48, 2);
                   }),
              options);
  // At its centre both eigenvalues are equal: the line term is exp(-1 / (2 beta^2)).
  EXPECT_LT(blob.at(48, 48), std::exp(-1 / (2 * options.beta * options.beta)) + 1e-3);
}

TEST(VesselFilter, TurnedPictureGivesTheTurnedResponse) {
  const auto level = [](int u, int v) {
    return kBackground - 0.1 * gaussian_line(0.8 * u - 0.6 * v - 20, 1.5) +
           0.05 * std::sin(0.2 * u) * std::cos(0.13 * v);
  };
  const Plane<float> response = respond(draw(kSide, kSide, level), {});
  const Plane<float> turned =
      respond(draw(kSide, kSide, [&](int u, int v) { return level(v, u); }), {});
  // Sums are taken in another order; where both eigenvalues nearly cancel, their ratio is loose.
  constexpr float kOrderOfSums = 2e-3F;
  for (int v = 0; v < kSide; ++v) {
    for (int u = 0; u < kSide; ++u) {
      EXPECT_NEAR(response.at(u, v), turned.at(v, u), kOrderOfSums) << u << ", " << v;
    }
  }
}

TEST(VesselFilter, AnySizeAndExtremePicturesStayWithinBounds) {
  for (const auto& [width, height] :
       {std::pair{1, 1}, {2, 3}, {1, 40}, {40, 1}, {17, 5}, {33, 65}}) {
    for (const int kind : {0, 1, 2, 3}) {
      const Plane<float> response =
          respond(draw(width, height,
                       [&](int u, int v) { return kind < 2 ? kind : ((u + v * (kind - 2)) & 1); }),
                  {});
      ASSERT_TRUE(response.same_size(width, height));
      for (const float value : response.values) {
        EXPECT_GE(value, 0);
        EXPECT_LE(value, 1);
      }
    }
  }
}

TEST(VesselFilter, SensesOptionsThatMakeNoSense) {
  VesselFilterOptions options;
  EXPECT_THROW(VesselFilter(0, 5, options), std::invalid_argument);
  options.scales = {};
  EXPECT_THROW(VesselFilter(5, 5, options), std::invalid_argument);
  options.scales = {0.1};
  EXPECT_THROW(VesselFilter(5, 5, options), std::invalid_argument);
  options.scales = {std::nan("")};
  EXPECT_THROW(VesselFilter(5, 5, options), std::invalid_argument);
  options = {};
  options.beta = 0;
  EXPECT_THROW(VesselFilter(5, 5, options), std::invalid_argument);
  Plane<float> response;
  VesselFilter filter(5, 5, {});
  EXPECT_THROW(filter.apply(Plane<float>(4, 5), response), std::invalid_argument);
}

TEST(VesselFilter, SameBytesOnAnyNumberOfThreadsAndEveryInstructionSet) {
  const Plane<float> picture = draw(155, 117, [](int u, int v) {
    return kBackground - 0.1 * gaussian_line(0.8 * u - 0.6 * v - 20, 1.5) +
           0.05 * std::sin(0.2 * u) * std::cos(0.13 * v);
  });
  set_thread_count(1);
  const Plane<float> expected = respond(picture, {});
  set_thread_count(4);
  EXPECT_EQ(respond(picture, {}).values, expected.values);
  set_thread_count(0);
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
    EXPECT_EQ(respond(picture, {}).values, expected.values) << hwy::TargetName(target);
  }
  hwy::SetSupportedTargetsForTest(0);
  hwy::GetChosenTarget().Update(hwy::SupportedTargets());
}

}  // namespace
}  // namespace gastronaut::perception

#include "evaluate/surface_thickness.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <variant>

#include "random_numbers.hpp"

namespace gastronaut::evaluation {
namespace {

constexpr double kMillimetre = 1e-3;
constexpr double kSpacing = 0.1 * kMillimetre;
constexpr int kSide = 120;  // surfels
constexpr double kWorkingDistance = 0.04;
// Floats of a position of centimetres, seen by a difference.
constexpr double kFloat = 1e-8;

// A square of surfels in a plane that lies aslant; `height` metres above it.
template <class Height>
void add_layer(std::vector<Surfel>& surfels, const Height& height, double spacing = kSpacing) {
  const Eigen::Quaterniond turn = so3_exp({0.4, -0.7, 0.2});
  for (int i = 0; i < kSide; ++i) {
    for (int k = 0; k < kSide; ++k) {
      Surfel surfel;
      surfel.position = (turn * Eigen::Vector3d(i * spacing, k * spacing, height())).cast<float>();
      surfel.normal = (turn * Eigen::Vector3d::UnitZ()).cast<float>();
      surfels.push_back(surfel);
    }
  }
}

std::optional<double> find(const Metrics& metrics, const std::string& key) {
  for (const auto& [name, value] : metrics.list()) {
    if (name != "surface.thickness." + key) continue;
    if (const double* number = std::get_if<double>(&value)) return *number;
    return static_cast<double>(std::get<std::int64_t>(value));
  }
  return std::nullopt;
}

Metrics thickness_of(const std::vector<Surfel>& surfels,
                     double working_distance = kWorkingDistance) {
  Metrics metrics;
  set_thickness_metrics(metrics, surfels, working_distance);
  return metrics;
}

TEST(SurfaceThicknessTest, OfANoisyPlaneIsTheNoise) {
  constexpr double kSigma = 0.1 * kMillimetre;
  Draws draws(7);
  std::vector<Surfel> surfels;
  add_layer(surfels, [&] { return kSigma * draws.normal(); });
  const Metrics metrics = thickness_of(surfels);
  // Inside of the square a disc of 0.7 mm holds 154 surfels: of that many numbers the standard
  // deviation scatters by 1 / sqrt(2 * 154), and much less in the mean over thousands of discs.
  constexpr double kScatter = 0.057;
  EXPECT_NEAR(find(metrics, "mean").value(), kSigma, 0.02 * kSigma);
  EXPECT_NEAR(find(metrics, "median").value(), kSigma, 0.02 * kSigma);
  // The 90 % quantile of a normal distribution is 1.28 standard deviations out; discs at the rim
  // hold down to a quarter as many and scatter up to twice as much.
  EXPECT_GT(find(metrics, "p90").value(), kSigma);
  EXPECT_LT(find(metrics, "p90").value(), (1 + 2 * 1.28 * kScatter) * kSigma);
  EXPECT_EQ(find(metrics, "share_double"), 0);
  EXPECT_EQ(find(metrics, "count"), kSide * kSide / 3);  // every third: at most 5000
}

TEST(SurfaceThicknessTest, OfTwoLayersIsHalfTheirDistance) {
  constexpr double kDistance = 1.1 * kMillimetre;
  std::vector<Surfel> surfels;
  for (const double height : {0.0, kDistance}) add_layer(surfels, [=] { return height; });
  const Metrics metrics = thickness_of(surfels);
  for (const char* key : {"mean", "median", "p90"}) {
    EXPECT_NEAR(find(metrics, key).value(), kDistance / 2, kFloat) << key;
  }
  EXPECT_EQ(find(metrics, "share_double"), 1);
}

TEST(SurfaceThicknessTest, ALayerFurtherAwayOrOfTheOtherSideIsAnotherSurface) {
  std::vector<Surfel> surfels;
  for (const double height : {0.0, 5 * kMillimetre, 1 * kMillimetre}) {
    add_layer(surfels, [=] { return height; });
  }
  // What is seen from the other side, as of a fold.
  for (auto surfel = surfels.end() - kSide * kSide; surfel != surfels.end(); ++surfel) {
    surfel->normal = -surfel->normal;
  }
  EXPECT_NEAR(find(thickness_of(surfels), "mean").value(), 0, kFloat);
}

TEST(SurfaceThicknessTest, LengthsGoByTheWorkingDistance) {
  constexpr double kRoom = 50;  // times a stomach
  std::vector<Surfel> surfels;
  for (const double height : {0.0, 1.1 * kMillimetre}) {
    add_layer(
        surfels, [=] { return kRoom * height; }, kRoom * kSpacing);
  }
  const Metrics metrics = thickness_of(surfels, kRoom * kWorkingDistance);
  EXPECT_NEAR(find(metrics, "mean").value(), kRoom * 0.55 * kMillimetre, kRoom * kFloat);
  EXPECT_EQ(find(metrics, "share_double"), 1);
}

TEST(SurfaceThicknessTest, OfNothingOrSingleSurfelsIsNotSaid) {
  EXPECT_TRUE(thickness_of({}).list().empty());
  std::vector<Surfel> sparse;
  add_layer(
      sparse, [] { return 0.0; }, 10 * kMillimetre);
  EXPECT_TRUE(thickness_of(sparse).list().empty());
}

}  // namespace
}  // namespace gastronaut::evaluation

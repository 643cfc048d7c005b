// The vessel filter beside scikit-image 0.19.3's Frangi filter (Debian's python3-skimage), whose
// results on three pictures lie in the shared data: a retina, tissue, and a sinus.
//
// scikit-image differentiates the smoothed picture by first differences twice (numpy.gradient),
// which widens the kernel and halves the response of one-pixel lines; ours uses the Gaussian's own
// derivatives. So single pixels differ, and where the larger of two opposite eigenvalues changes
// the response is cut off at another place: the comparison is by correlation, as SOURCE.txt there
// advises, and by the pixels that answer most.
//
// That nothing else differs is shown in two steps through Frangi's formulas written out in double
// precision at full resolution: with scikit-image's derivatives they give its stored results to
// rounding, and with the Gaussian's derivatives they give the filter's.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <numeric>
#include <opencv2/imgcodecs.hpp>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "depth_estimator/vessel_filter.hpp"

namespace gastronaut::perception {
namespace {

// Exact Gaussian derivatives reach 0.979 (retina, scale 2 alone) to 0.995 in double precision; the
// rest is scikit-image's first differences.
constexpr double kLeastCorrelation = 0.975;
// Of the tenth of the pixels that answer most, the part that is the same.
constexpr double kLeastOverlap = 0.85;
constexpr double kPeerGamma = 15.0 / 255;  // scikit-image's gamma on levels of 0 to 255
constexpr int kSide = 512;
// scikit-image's results are stored as floats.
constexpr double kFloatRounding = 1e-6;
// At full resolution the filter's kernels are cut where the second derivative is 0.5 % of its peak.
constexpr double kCutKernel = 0.01;
// Coarse scales: halving and cubic interpolation of the Hessian.
constexpr double kInterpolation = 0.08;
// Where l1 = -l2 the response jumps between 0 and exp(-1 / (2 beta^2)) = 0.14 by the last digit:
// this part of the pixels may differ by more.
constexpr double kAtTheJump = 1e-3;

std::filesystem::path data_folder() {
  const char* shared = std::getenv("GASTRONAUT_DATA");
  return (shared != nullptr ? std::filesystem::path(shared)
                            : std::filesystem::path(GASTRONAUT_SOURCE_DIR) / "../shared/data") /
         "vesselness/peer_outputs";
}

// 512 x 512 little-endian floats behind a numpy header.
std::vector<float> read_npy(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::string start(10, '\0');
  file.read(start.data(), 10);
  const auto header =
      static_cast<unsigned char>(start[8]) + 256 * static_cast<unsigned char>(start[9]);
  std::string description(static_cast<std::size_t>(header), '\0');
  file.read(description.data(), header);
  EXPECT_NE(description.find("<f4"), std::string::npos) << path;
  EXPECT_NE(description.find("(512, 512)"), std::string::npos) << path;
  std::vector<float> values(kSide * kSide);
  file.read(reinterpret_cast<char*>(values.data()),
            static_cast<std::streamsize>(values.size() * sizeof(float)));
  EXPECT_TRUE(file.good()) << path;
  return values;
}

double correlation(const std::vector<float>& a, const std::vector<float>& b) {
  const auto mean = [](const std::vector<float>& values) {
    return std::accumulate(values.begin(), values.end(), 0.0) / static_cast<double>(values.size());
  };
  const double mean_a = mean(a);
  const double mean_b = mean(b);
  double ab = 0;
  double aa = 0;
  double bb = 0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    const double da = static_cast<double>(a[i]) - mean_a;
    const double db = static_cast<double>(b[i]) - mean_b;
    ab += da * db;
    aa += da * da;
    bb += db * db;
  }
  return ab / std::sqrt(aa * bb);
}

double overlap_of_strongest(const std::vector<float>& a, const std::vector<float>& b) {
  const auto strongest = [](const std::vector<float>& values) {
    std::vector<std::size_t> order(values.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t i, std::size_t k) { return values[i] > values[k]; });
    order.resize(values.size() / 10);
    std::sort(order.begin(), order.end());
    return order;
  };
  const std::vector<std::size_t> of_a = strongest(a);
  const std::vector<std::size_t> of_b = strongest(b);
  std::vector<std::size_t> both;
  std::set_intersection(of_a.begin(), of_a.end(), of_b.begin(), of_b.end(),
                        std::back_inserter(both));
  return static_cast<double>(both.size()) / static_cast<double>(of_a.size());
}

using Samples = std::vector<double>;  // kSide rows of kSide

std::size_t at(int u, int v) {
  return static_cast<std::size_t>(v) * kSide + static_cast<std::size_t>(u);
}

int reflected(int i) {
  if (i < 0) return -1 - i;
  return i < kSide ? i : 2 * kSide - 1 - i;
}

Samples transposed(const Samples& in) {
  Samples out(in.size());
  for (int v = 0; v < kSide; ++v) {
    for (int u = 0; u < kSide; ++u) out[at(u, v)] = in[at(v, u)];
  }
  return out;
}

// Along the rows: sum of weights[radius + i] in[u + i].
Samples correlated(const Samples& in, const std::vector<double>& weights) {
  const int radius = static_cast<int>(weights.size() / 2);
  Samples out(in.size());
  for (int v = 0; v < kSide; ++v) {
    for (int u = 0; u < kSide; ++u) {
      for (int i = -radius; i <= radius; ++i) {
        out[at(u, v)] +=
            weights[static_cast<std::size_t>(radius + i)] * in[at(reflected(u + i), v)];
      }
    }
  }
  return out;
}

// The sampled Gaussian (order 0), its first or second derivative.
std::vector<double> gaussian_weights(double sigma, int radius, int order) {
  std::vector<double> weights;
  double total = 0;
  for (int i = -radius; i <= radius; ++i) {
    const double gaussian = std::exp(-i * i / (2 * sigma * sigma));
    total += gaussian;
    const double factor[] = {1, i / (sigma * sigma),
                             (i * i / (sigma * sigma) - 1) / (sigma * sigma)};
    weights.push_back(factor[order] * gaussian);
  }
  for (double& weight : weights) weight /= total;
  return weights;
}

struct Hessian {
  Samples xx, xy, yy;
};

Hessian gaussian_hessian(const Samples& picture, double sigma) {
  const int radius = static_cast<int>(std::ceil(8 * sigma));
  const auto derivative = [&](int order_x, int order_y) {
    const Samples along_y =
        correlated(transposed(picture), gaussian_weights(sigma, radius, order_y));
    return correlated(transposed(along_y), gaussian_weights(sigma, radius, order_x));
  };
  return {derivative(2, 0), derivative(1, 1), derivative(0, 2)};
}

// numpy.gradient along the rows.
Samples gradient(const Samples& in) {
  Samples out(in.size());
  for (int v = 0; v < kSide; ++v) {
    for (int u = 0; u < kSide; ++u) {
      const int left = std::max(u - 1, 0);
      const int right = std::min(u + 1, kSide - 1);
      out[at(u, v)] = (in[at(right, v)] - in[at(left, v)]) / (right - left);
    }
  }
  return out;
}

// Smoothed beyond the border with the border's own level, as scikit-image 0.19 does when asked for
// "reflect": its Gaussian filter reads that as scipy's "reflect".
Hessian scikit_image_hessian(const Samples& picture, double sigma) {
  const std::vector<double> weights = gaussian_weights(sigma, static_cast<int>(4 * sigma + 0.5), 0);
  const Samples smooth = correlated(transposed(correlated(transposed(picture), weights)), weights);
  const Samples x = gradient(smooth);
  const Samples y = transposed(gradient(transposed(smooth)));
  return {gradient(x), gradient(y), transposed(gradient(transposed(y)))};
}

// result = max(result, Frangi's response with beta = 0.5 and scikit-image's gamma).
void respond(const Hessian& hessian, double sigma, Samples& result) {
  for (std::size_t i = 0; i < result.size(); ++i) {
    const double scale = sigma * sigma;
    const double mean = scale * (hessian.xx[i] + hessian.yy[i]) / 2;
    const double root =
        std::hypot(scale * (hessian.xx[i] - hessian.yy[i]) / 2, scale * hessian.xy[i]);
    if (mean <= 0) continue;  // the eigenvalue of larger magnitude is mean + root only above
    const double ratio = (mean - root) / (mean + root);
    const double square = 2 * (mean * mean + root * root);
    result[i] = std::max(result[i], std::exp(-2 * ratio * ratio) *
                                        (1 - std::exp(-square / (2 * kPeerGamma * kPeerGamma))));
  }
}

// The difference that all but a kAtTheJump part of the pixels stay under, by the peak.
double difference_by_peak(const std::vector<float>& values, const Samples& expected) {
  std::vector<double> differences;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    differences.push_back(std::abs(static_cast<double>(values[i]) - expected[i]));
  }
  std::sort(differences.begin(), differences.end());
  const auto rank =
      static_cast<std::size_t>((1 - kAtTheJump) * static_cast<double>(differences.size() - 1));
  return differences[rank] / *std::max_element(expected.begin(), expected.end());
}

Plane<float> read_levels(const std::filesystem::path& path) {
  const cv::Mat levels = cv::imread(path.string(), cv::IMREAD_GRAYSCALE);
  if (levels.cols != kSide || levels.rows != kSide) {
    throw std::runtime_error(path.string() + ": not a picture of 512 x 512");
  }
  Plane<float> picture(kSide, kSide);
  std::transform(levels.begin<std::uint8_t>(), levels.end<std::uint8_t>(), picture.values.begin(),
                 [](std::uint8_t level) { return static_cast<float>(level) / 255; });
  return picture;
}

struct Peer {
  const char* output;
  std::vector<double> scales;
};

class VesselnessRegression : public ::testing::TestWithParam<const char*> {};

TEST_P(VesselnessRegression, AgreesWithScikitImage) {
  const std::filesystem::path folder = data_folder();
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "SKIPPED: no shared data at " << folder;
  const std::string name = GetParam();
  const Plane<float> picture = read_levels(folder / (name + "_green_crop512.png"));
  for (const Peer& peer : {Peer{"_frangi.npy", {1, 2, 3, 4, 5}}, Peer{"_frangi_s2only.npy", {2}}}) {
    VesselFilterOptions options;
    options.scales = peer.scales;
    // scikit-image: 1 - exp(-S^2 / (2 gamma^2)), as Frangi.
    options.structureness = kPeerGamma;
    Plane<float> response;
    VesselFilter(kSide, kSide, options).apply(picture, response);
    const std::vector<float> expected = read_npy(folder / (name + peer.output));
    EXPECT_GT(correlation(response.values, expected), kLeastCorrelation) << name << peer.output;
    EXPECT_GT(overlap_of_strongest(response.values, expected), kLeastOverlap)
        << name << peer.output;
  }
}

TEST_P(VesselnessRegression, FormulasWithScikitImagesDerivativesGiveItsResults) {
  const std::filesystem::path folder = data_folder();
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "SKIPPED: no shared data at " << folder;
  const std::string name = GetParam();
  const Plane<float> picture = read_levels(folder / (name + "_green_crop512.png"));
  const Samples levels(picture.values.begin(), picture.values.end());
  Samples response(levels.size());
  for (const double sigma : {1.0, 2.0, 3.0, 4.0, 5.0}) {
    respond(scikit_image_hessian(levels, sigma), sigma, response);
  }
  EXPECT_LT(difference_by_peak(read_npy(folder / (name + "_frangi.npy")), response),
            kFloatRounding);
}

TEST_P(VesselnessRegression, FormulasWithGaussianDerivativesGiveTheFiltersResults) {
  const std::filesystem::path folder = data_folder();
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "SKIPPED: no shared data at " << folder;
  const std::string name = GetParam();
  const Plane<float> picture = read_levels(folder / (name + "_green_crop512.png"));
  const Samples levels(picture.values.begin(), picture.values.end());
  VesselFilterOptions options;
  options.structureness = kPeerGamma;
  for (const auto& [sigma, tolerance] : {std::pair{1.0, kCutKernel},
                                         {1.6, kCutKernel},
                                         {2.0, kCutKernel},
                                         {2.5, kInterpolation},
                                         {4.0, kInterpolation},
                                         {6.0, kInterpolation}}) {
    Samples expected(levels.size());
    respond(gaussian_hessian(levels, sigma), sigma, expected);
    options.scales = {sigma};
    Plane<float> response;
    VesselFilter(kSide, kSide, options).apply(picture, response);
    EXPECT_LT(difference_by_peak(response.values, expected), tolerance) << name << " " << sigma;
  }
}

INSTANTIATE_TEST_SUITE_P(Pictures, VesselnessRegression,
                         ::testing::Values("retina", "tissue", "sinus"));

}  // namespace
}  // namespace gastronaut::perception

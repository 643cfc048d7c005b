#include "visual_slam/frame_tracker.hpp"

#include <fmt/format.h>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <initializer_list>
#include <stdexcept>
#include <utility>
#include <vector>

#include "numerics/parallel.hpp"
#include "visual_slam/tracking_kernels.hpp"

namespace gastronaut::slam {
namespace {

using Vector7d = Eigen::Matrix<double, kIcpUnknowns, 1>;
using Matrix7d = Eigen::Matrix<double, kIcpUnknowns, kIcpUnknowns>;

constexpr std::size_t kRowsAtOnce = 8;
constexpr int kLeastSide = 20;  // pixels of the coarsest level: a window of contrast and some
// Gauss-Newton steps from the finest level to the coarsest; before the latter's, rotation alone.
constexpr std::array<int, kTrackingLevels> kSteps = {4, 6, 10};
constexpr int kRotationSteps = 4;
constexpr double kRgbStartSigma = 0.5;  // normalised albedo; the residuals correct it
constexpr double kRgbFloor = 0.01;
constexpr float kRgbGate = 3;
constexpr double kExactScale = 1e-5;       // prior of the depth scale where it is not estimated
constexpr double kLeastCorrelation = 0.2;  // of the albedos: below it they share noise only
constexpr double kBadFit = 4;  // times the expected noise: depths alone do not prove the place then
// Cauchy's weights see 0.785 of a Gaussian's variance when their scale is right, so the mean
// square under the weights times this is a robust variance that comes to rest at the right value.
constexpr double kCauchyVariance = 1 / 0.785;
// Blocks joined to one that is taken as independent of the next: 32 pixels square.
constexpr std::size_t kBlockColumns = 2;
constexpr std::size_t kBlockRows = 4;
constexpr double kAlongAxis = 0.9;  // cosine from which on a direction is called by an axis' name

template <int kUnknowns>
Matrix7d symmetric(const TrackingSums& sums, std::size_t from) {
  Matrix7d matrix = Matrix7d::Zero();
  for (int i = 0; i < kUnknowns; ++i) {
    for (int j = i; j < kUnknowns; ++j) matrix(i, j) = matrix(j, i) = sums[from++];
  }
  return matrix;
}

template <int kUnknowns>
Vector7d vector(const TrackingSums& sums, std::size_t from) {
  Vector7d result = Vector7d::Zero();
  for (int i = 0; i < kUnknowns; ++i) result(i) = sums[from++];
  return result;
}

// One sigma of relative depth and of normalised albedo, from the residuals.
struct Noise {
  double icp = 0;
  double rgb = kRgbStartSigma;
};

// The alignment under way.
struct Alignment {
  SE3 frame_T_model;
  double log_scale = 0;  // of the frame's depth
  Noise noise;
};

// Normal equations in units of the working distance, of radians, and of the logarithm of scale.
struct NormalEquations {
  Vector7d unit;
  Matrix7d icp, rgb, prior;
  Matrix7d pixels;      // rgb if all pixels were registered exactly
  Matrix7d registered;  // rgb = registered * pixels
  Vector7d right;       // (icp + rgb + prior) step = right
};

// One level's pictures, and how they are to be compared.
class Level {
 public:
  Level(const ModelLevel& model, const FrameLevel& frame, const TrackerOptions& options,
        double relative_std)
      : model_(model), frame_(frame), options_(options), relative_std_(relative_std) {
    rough_ = std::max(options.depth_floor, std::hypot(model.roughness, frame.roughness));
    patch_pixels_ = std::pow(std::max(1.0, options.patch * model.grid.width), 2);
  }

  TrackingSums compare_all(const Alignment& alignment,
                           std::vector<BlockGradient>* blocks = nullptr) const;
  // One sigma of relative depth that the sources admit.
  double expected_icp() const { return std::hypot(rough_, relative_std_); }
  // The noise that the residuals show, at least what the depths admit.
  Noise noise(const TrackingSums& sums) const;
  // How much a sum of squares of relative depth and of normalised albedo weighs in E.
  double icp_factor(const Noise& noise) const;
  double rgb_factor(const Noise& noise) const;
  NormalEquations normal_equations(const TrackingSums& sums, const Alignment& alignment) const;

 private:
  const ModelLevel& model_;
  const FrameLevel& frame_;
  const TrackerOptions& options_;
  double relative_std_;
  double rough_;
  double patch_pixels_;
};

TrackingSums Level::compare_all(const Alignment& alignment,
                                std::vector<BlockGradient>* blocks) const {
  TrackingState state;
  const Eigen::Matrix3d rotation = alignment.frame_T_model.rotation.toRotationMatrix();
  const Eigen::Vector3d centre = alignment.frame_T_model.inverse().translation;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      state.frame_R_model[static_cast<std::size_t>(3 * i + j)] = static_cast<float>(rotation(i, j));
    }
    state.centre[static_cast<std::size_t>(i)] = static_cast<float>(centre(i));
  }
  state.depth_scale = static_cast<float>(std::exp(alignment.log_scale));
  state.icp_sigma = static_cast<float>(alignment.noise.icp);
  state.rgb_sigma = static_cast<float>(alignment.noise.rgb);
  state.distance_gate = static_cast<float>(options_.distance_gate + 4 * relative_std_);
  state.rgb_gate = kRgbGate;
  state.cosine_gate2 = static_cast<float>(options_.cosine_gate * options_.cosine_gate);
  // Neighbours on a slope are further apart where pixels are larger.
  state.jump = static_cast<float>(options_.pyramid.jump * frame_.pixel);
  const auto rows = static_cast<std::size_t>(model_.grid.height);
  const std::size_t columns = model_.depth.values.size() / rows / kTrackingLanes;
  if (blocks) blocks->assign((rows + kRowsAtOnce - 1) / kRowsAtOnce * columns, {});
  return parallel_reduce_in_order(
      rows, kRowsAtOnce, TrackingSums{},
      [&](std::size_t begin, std::size_t end) {
        return compare(model_, frame_, state, static_cast<int>(begin), static_cast<int>(end),
                       blocks ? blocks->data() + begin / kRowsAtOnce * columns : nullptr);
      },
      [](TrackingSums total, const TrackingSums& part) {
        for (std::size_t k = 0; k < total.size(); ++k) total[k] += part[k];
        return total;
      });
}

Noise Level::noise(const TrackingSums& sums) const {
  const auto deviation = [&](std::size_t square, std::size_t weight) {
    return sums[weight] > 0 ? std::sqrt(kCauchyVariance * sums[square] / sums[weight]) : 0;
  };
  return {std::max(deviation(kIcpSquare, kIcpWeight), expected_icp()),
          std::max(deviation(kRgbSquare, kRgbWeight), kRgbFloor)};
}

// The error of a mean over many pixels decides: noise of variance r^2 that is each pixel's own and
// noise of variance s^2 that a patch of A pixels shares weigh as independent noise of r^2 + A s^2.
double Level::icp_factor(const Noise& noise) const {
  const double smooth = relative_std_ * relative_std_;
  const double own = std::max(rough_ * rough_, noise.icp * noise.icp - smooth);
  return options_.icp_weight / (own + patch_pixels_ * smooth);
}

double Level::rgb_factor(const Noise& noise) const {
  return options_.rgb_weight / (noise.rgb * noise.rgb);
}

NormalEquations Level::normal_equations(const TrackingSums& sums,
                                        const Alignment& alignment) const {
  NormalEquations equations;
  const double distance = sums[kDepthSum] / sums[kVisible];
  equations.unit << distance, distance, distance, 1, 1, 1, 1;
  const auto scaled = [&](const Matrix7d& matrix) -> Matrix7d {
    return equations.unit.asDiagonal() * matrix * equations.unit.asDiagonal();
  };
  const double icp = icp_factor(alignment.noise);
  const double rgb = rgb_factor(alignment.noise);
  equations.icp = icp * scaled(symmetric<kIcpUnknowns>(sums, kIcpMatrix));
  equations.pixels = rgb * scaled(symmetric<kRgbUnknowns>(sums, kRgbMatrix));
  // However many they are, pixels know a direction no better than they are registered.
  const double shift = options_.misregistration / (model_.grid.fx * model_.pixel);
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(equations.pixels.topLeftCorner<6, 6>());
  const Vector6d share =
      (1 + shift * shift * solver.eigenvalues().array().max(0)).inverse().matrix();
  equations.registered = Matrix7d::Identity();
  equations.registered.topLeftCorner<6, 6>() =
      solver.eigenvectors() * share.asDiagonal() * solver.eigenvectors().transpose();
  equations.rgb = Matrix7d::Zero();
  equations.rgb.topLeftCorner<6, 6>() = solver.eigenvectors() *
                                        share.cwiseProduct(solver.eigenvalues()).asDiagonal() *
                                        solver.eigenvectors().transpose();
  // So weak for the twist that it only matters where nothing else holds.
  const double scale_std =
      options_.estimate_depth_scale ? std::max(relative_std_, kExactScale) : kExactScale;
  equations.prior = Matrix7d::Identity();
  equations.prior(6, 6) = 1 / (scale_std * scale_std);
  const Vector7d by_icp = equations.unit.cwiseProduct(vector<kIcpUnknowns>(sums, kIcpVector));
  const Vector7d by_rgb = equations.unit.cwiseProduct(vector<kRgbUnknowns>(sums, kRgbVector));
  equations.right = -icp * by_icp - rgb * (equations.registered * by_rgb);
  equations.right(6) -= equations.prior(6, 6) * alignment.log_scale;
  return equations;
}

void step(const NormalEquations& equations, bool rotation_only, Alignment& alignment) {
  const Matrix7d matrix = equations.icp + equations.rgb + equations.prior;
  Vector7d unknowns = Vector7d::Zero();
  if (rotation_only) {
    const Eigen::Matrix3d block = matrix.block<3, 3>(3, 3);
    const Eigen::Vector3d right = equations.right.segment<3>(3);
    unknowns.segment<3>(3) = block.ldlt().solve(right);
  } else {
    unknowns = equations.unit.asDiagonal() * matrix.ldlt().solve(equations.right);
  }
  alignment.frame_T_model = alignment.frame_T_model * SE3::exp(unknowns.head<6>());
  alignment.log_scale += unknowns(6);
}

// How much larger the gradient's variance is than the normal matrix says, measured between blocks
// of pixels: errors that neighbours share and weights that are not inverse variances are in it.
struct DesignEffect {
  double icp = 1;
  double rgb = 1;
};

DesignEffect design_effect(const std::vector<BlockGradient>& blocks, std::size_t columns,
                           const NormalEquations& equations, double icp_factor, double rgb_factor) {
  const std::size_t rows = blocks.size() / columns;
  double icp = 0;
  double rgb = 0;
  for (std::size_t v = 0; v < rows; v += kBlockRows) {
    for (std::size_t u = 0; u < columns; u += kBlockColumns) {
      Vector7d icp_sum = Vector7d::Zero();
      Vector6d rgb_sum = Vector6d::Zero();
      for (std::size_t j = v; j < std::min(v + kBlockRows, rows); ++j) {
        for (std::size_t i = u; i < std::min(u + kBlockColumns, columns); ++i) {
          const BlockGradient& block = blocks[j * columns + i];
          icp_sum += Eigen::Map<const Vector7d>(block.icp.data());
          rgb_sum += Eigen::Map<const Vector6d>(block.rgb.data());
        }
      }
      icp += icp_sum.head<6>().cwiseProduct(equations.unit.head<6>()).squaredNorm();
      rgb += rgb_sum.cwiseProduct(equations.unit.head<6>()).squaredNorm();
    }
  }
  const auto ratio = [](double square, double factor, const Matrix7d& matrix) {
    const double trace = matrix.topLeftCorner<6, 6>().trace();
    return trace > 0 ? factor * factor * square / trace : 1;
  };
  // Depth errors wider than a block show in none of them: never below what is expected.
  return {std::max(1.0, ratio(icp, icp_factor, equations.icp)),
          ratio(rgb, rgb_factor, equations.pixels)};
}

// A surface that turns by no more than the map's normals are wrong holds nothing.
Matrix7d without_doubtful_normals(const Matrix7d& icp, double normal_std) {
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(icp.topLeftCorner<6, 6>());
  const double doubtful = normal_std * normal_std * solver.eigenvalues()(5);
  Matrix7d result = icp;
  Vector6d kept;
  for (int i = 0; i < 6; ++i) {
    const double value = solver.eigenvalues()(i);
    kept(i) = value > doubtful ? (value - doubtful) / value : 0;
  }
  // Scales the eigenvectors, so that what they share with the depth's scale goes with them.
  Matrix7d scale = Matrix7d::Identity();
  scale.topLeftCorner<6, 6>() =
      solver.eigenvectors() * kept.cwiseSqrt().asDiagonal() * solver.eigenvectors().transpose();
  return scale * result * scale;
}

std::string direction_in_words(const Vector6d& direction) {
  const bool turns = direction.tail<3>().norm() > direction.head<3>().norm();
  const Eigen::Vector3d axis = (turns ? direction.tail<3>() : direction.head<3>()).normalized();
  int largest = 0;
  const double cosine = axis.cwiseAbs().maxCoeff(&largest);
  const std::string name =
      cosine > kAlongAxis
          ? fmt::format("the camera's {} axis", "xyz"[largest])
          : fmt::format("({:.2f} {:.2f} {:.2f}) in the camera frame", axis.x(), axis.y(), axis.z());
  return fmt::format("no hold {} {}", turns ? "in rotation about" : "along", name);
}

double correlation(const TrackingSums& sums) {
  const double squares = sums[kFrameAlbedo2] * sums[kModelAlbedo2];
  return squares > 0 ? sums[kAlbedoProduct] / std::sqrt(squares) : 0;
}

}  // namespace

FrameTracker::FrameTracker(const PinholeGrid& grid, const TrackerOptions& options)
    : grid_(grid), options_(options) {
  const PinholeGrid coarsest = grid.coarser(1 << (kTrackingLevels - 1));
  if (coarsest.width < kLeastSide || coarsest.height < kLeastSide) {
    throw std::invalid_argument(
        fmt::format("tracking needs pictures of at least {0} x {0} pixels, not {1} x {2}",
                    kLeastSide << (kTrackingLevels - 1), grid.width, grid.height));
  }
  frame_ = frame_pyramid(grid);
  model_ = model_pyramid(grid);
}

TrackingResult FrameTracker::track(const Frame& frame, const ModelView& model,
                                   const SE3& map_T_camera_start) {
  const auto fits = [&](const PinholeGrid& grid,
                        std::initializer_list<const Plane<float>*> planes) {
    return grid == grid_ && std::all_of(planes.begin(), planes.end(), [&](const auto* plane) {
             return plane->same_size(grid_.width, grid_.height);
           });
  };
  if (!fits(frame.grid, {&frame.depth, &frame.albedo}) ||
      !fits(model.grid,
            {&model.depth, &model.normal_x, &model.normal_y, &model.normal_z, &model.albedo})) {
    throw std::invalid_argument("frame and model view must have the tracker's grid");
  }
  fill(frame, options_.pyramid, frame_);
  fill(model, options_.pyramid, model_);

  TrackingResult result;
  result.map_T_camera = map_T_camera_start;
  const auto lost = [&](std::string cause) {
    result.cause = std::move(cause);
    return result;
  };

  Alignment alignment;
  alignment.frame_T_model = map_T_camera_start.inverse() * model.map_T_camera;
  alignment.noise.icp = options_.distance_gate / 2 + frame.relative_std;
  TrackingSums sums{};
  const auto compare_and_step = [&](const Level& level, bool rotation_only) {
    sums = level.compare_all(alignment);
    if (!(sums[kVisible] > 0)) return;
    alignment.noise = level.noise(sums);
    step(level.normal_equations(sums, alignment), rotation_only, alignment);
  };
  for (std::size_t l = kTrackingLevels; l-- > 0;) {
    const Level level(model_[l], frame_[l], options_, frame.relative_std);
    const int rotations = l + 1 == kTrackingLevels ? kRotationSteps : 0;
    for (int i = 0; i < rotations; ++i) compare_and_step(level, true);
    for (int i = 0; i < kSteps[l]; ++i) compare_and_step(level, false);
  }

  const Level finest(model_[0], frame_[0], options_, frame.relative_std);
  std::vector<BlockGradient> blocks;
  sums = finest.compare_all(alignment, &blocks);
  const double pixels = static_cast<double>(grid_.width) * grid_.height;
  if (sums[kVisible] < options_.least_visible * pixels) {
    return lost(fmt::format("the map shows something in {:.1f} % of the view only",
                            100 * sums[kVisible] / pixels));
  }
  const double compared = std::max(sums[kIcpCompared], sums[kRgbCompared]);
  if (compared < options_.least_visible * pixels) {
    return lost(fmt::format("neither depth nor albedo for {:.0f} % of what the map shows",
                            100 * (1 - compared / sums[kVisible])));
  }
  alignment.noise = finest.noise(sums);
  const auto rms = [&](std::size_t square, std::size_t weight) {
    return sums[weight] > 0 ? std::sqrt(kCauchyVariance * sums[square] / sums[weight]) : 0;
  };
  result.icp_rms = rms(kIcpMetres2, kIcpWeight);
  result.rgb_rms = rms(kRgbSquare, kRgbWeight);
  const bool by_depth = options_.icp_weight > 0 && sums[kIcpCompared] > 0;
  result.inlier_fraction =
      by_depth ? sums[kIcpInliers] / sums[kIcpCompared] : sums[kRgbInliers] / sums[kRgbCompared];
  result.depth_scale = std::exp(alignment.log_scale);
  if (result.inlier_fraction < options_.least_inliers) {
    return lost(
        fmt::format("only {:.0f} % of the frame fits the map", 100 * result.inlier_fraction));
  }
  if (by_depth && rms(kIcpSquare, kIcpWeight) > options_.largest_residual + frame.relative_std) {
    return lost(fmt::format("depths are {:.1f} % off the map", 100 * rms(kIcpSquare, kIcpWeight)));
  }
  const bool by_colour = correlation(sums) > kLeastCorrelation;
  const bool depth_fits = by_depth && alignment.noise.icp < kBadFit * finest.expected_icp();
  if (!depth_fits && !by_colour) return lost("the frame does not look like the map");

  NormalEquations equations = finest.normal_equations(sums, alignment);
  const DesignEffect effect = design_effect(
      blocks,
      model_[0].depth.values.size() / static_cast<std::size_t>(grid_.height) / kTrackingLanes,
      equations, finest.icp_factor(alignment.noise), finest.rgb_factor(alignment.noise));
  if (by_depth) {
    equations.icp = without_doubtful_normals(equations.icp, options_.normal_std);
  }
  if (!by_colour) {
    equations.rgb.setZero();
    equations.pixels.setZero();
  }
  const Matrix7d inverse =
      (equations.icp + equations.rgb + equations.prior).ldlt().solve(Matrix7d::Identity());
  // Variance of the gradient: noise, and the shift common to all pixels.
  const double shift = options_.misregistration / grid_.fx;
  const Matrix7d by_colour_variance =
      equations.registered *
      (effect.rgb * equations.pixels + shift * shift * equations.pixels * equations.pixels) *
      equations.registered;
  const Matrix7d variance =
      inverse * (effect.icp * equations.icp + by_colour_variance + equations.prior) * inverse;
  const Vector6d unit = equations.unit.head<6>();
  const Matrix6d camera_from_model = alignment.frame_T_model.adjoint() * unit.asDiagonal();
  result.covariance =
      camera_from_model * variance.topLeftCorner<6, 6>() * camera_from_model.transpose();
  result.map_T_camera = model.map_T_camera * alignment.frame_T_model.inverse();
  result.status = TrackingStatus::kOk;

  // Along directions without hold the camera stays where it was thought to be.
  const Matrix6d comparable =
      unit.cwiseInverse().asDiagonal() * result.covariance * unit.cwiseInverse().asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Matrix6d> solver(comparable);
  Vector6d motion =
      unit.cwiseInverse().cwiseProduct((map_T_camera_start.inverse() * result.map_T_camera).log());
  for (int i = 5; i >= 0; --i) {
    if (solver.eigenvalues()(i) < options_.hold * options_.hold) break;
    const Vector6d direction = solver.eigenvectors().col(i);
    motion -= direction * direction.dot(motion);
    result.status = TrackingStatus::kDegraded;
    result.cause += (result.cause.empty() ? "" : ", ") + direction_in_words(direction);
  }
  if (result.status == TrackingStatus::kDegraded) {
    result.map_T_camera = map_T_camera_start * SE3::exp(unit.cwiseProduct(motion));
  }
  return result;
}

}  // namespace gastronaut::slam
